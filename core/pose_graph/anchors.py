"""Anchors: places of points of a robot as the world outside says them, and where a map lies in that world.

The world is level: x east, y north, z up, metres. A map has a place and a heading in it that nobody knows before, and
its frame may be tilted by a little (`alignment.TILT_SIGMA_RAD`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.core.pose_graph.graph import Node

Array64 = NDArray[np.float64]

LEAST_ANCHORS = 4
"""Anchors that must agree before any counts; a heading that is told is as good as three."""

LEAST_SHARE = 0.5
"""Of the anchors of a frame must agree, at least."""

MOST_HEADING_SIGMA_RAD = np.radians(1.0)
"""The heading of a map must be as sure by the spread of its anchors before any counts."""


class AnchorState(StrEnum):
    """The verdict of the graph on an anchor."""

    IN_MAP = "IN_MAP"
    SET_ASIDE = "SET_ASIDE"
    NOT_ALIGNED = "NOT_ALIGNED"


class AnchorReason(StrEnum):
    """The reason why an anchor does not hold the map."""

    DISAGREES = "DISAGREES"
    """It lies where neither drive nor the other anchors put it."""
    TOO_FEW = "TOO_FEW"
    """Fewer anchors agree than the heading of a map must rest on."""
    NOT_SPREAD = "NOT_SPREAD"
    """The anchors lie too near each other, or on too short a way, to tell the heading of the map."""
    MOSTLY_DISAGREE = "MOSTLY_DISAGREE"
    """Most of the anchors contradict each other or the drive."""
    MISREAD = "MISREAD"
    """A tag: the same pass has read another id at its spot far more often."""
    MOVED = "MOVED"
    """A tag: most passes, or the only other one, see it elsewhere."""
    TWO_PLACES = "TWO_PLACES"
    """A tag: one drive has seen its id at two places."""
    SEEN_ONCE = "SEEN_ONCE"
    """A tag: no other pass has seen it."""
    NOT_JOINED = "NOT_JOINED"
    """A tag: passes in other frames of the map alone have seen it; no loop joins them."""


@dataclass(frozen=True)
class Heading:
    """The heading of a direction (3,) of a submap's frame: counter-clockwise from east, radians, with its sigma."""

    forward_submap: Array64
    angle_rad: float
    sigma_rad: float


@dataclass(frozen=True)
class Anchor:
    """The measured place of a point of submap `node`: point_submap (3,) in its frame, place_world (3,) in the world.

    covariance (3, 3) of the place, m^2. `heading` is there where a direction was measured, too.
    """

    name: str
    node: Node
    point_submap: Array64
    place_world: Array64
    covariance: Array64
    heading: Heading | None = None


@dataclass(frozen=True)
class JudgedAnchor:
    """The verdict on an anchor. residual_m (3,): its place less where the map has it, NaN where nothing is aligned;
    squared_distance, the same by its covariance.
    """

    state: AnchorState
    reason: AnchorReason | None
    residual_m: Array64
    squared_distance: float


@dataclass(frozen=True)
class AnchoredSession:
    """The anchors of a session as a whole: `anchors` of `of_anchors` hold the map; offset_m (3,), the median of the
    places of all, less where the map has them; squared_distance, the same by the covariance of one anchor;
    sigma_factor, by which their standard deviations were raised; elsewhere: they contradict the map as a whole.
    """

    session: str
    anchors: int
    of_anchors: int
    offset_m: Array64
    squared_distance: float
    sigma_factor: float
    elsewhere: bool


@dataclass(frozen=True)
class Georeference:
    """The place of a map frame in the world: that of the component whose first session is `session`.

    T_world_map (4, 4); covariance (6, 6) of its tangent (x, y, z, rx, ry, rz) in the map frame, metres and radians;
    heading_sigma_rad by the spread of the `anchors` that hold it, of so many; residual_m, the root mean square of
    theirs across the ground; sessions, those whose anchors are not as they state.
    """

    session: str
    T_world_map: se3.Matrix4
    covariance: Array64
    heading_sigma_rad: float
    anchors: int
    of_anchors: int
    residual_m: float
    sessions: tuple[AnchoredSession, ...] = ()


def require_anchors(anchors: Sequence[Anchor], lengths: Mapping[str, int]) -> None:
    """Raises BadField where an anchor names a submap that is not there, or has numbers that are none."""
    for one in anchors:
        if not 0 <= one.node.ordinal < lengths.get(one.node.session, 0):
            raise BadField(f"anchor {one.name} names submap {one.node.ordinal} of {one.node.session}", field="anchors")
        numbers = np.concatenate([one.point_submap, one.place_world, one.covariance.ravel()])
        if not np.isfinite(numbers).all():
            raise BadField(f"anchor {one.name} has a place that is not finite", field="anchors")
        if np.linalg.eigvalsh(one.covariance)[0] < 0.0:
            raise BadField(f"anchor {one.name} has a negative variance", field="anchors")
