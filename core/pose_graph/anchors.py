"""Anchors: places of points of a robot as the world outside says them, and where a map lies in that world.

The world is level: x east, y north, z up, metres. A map has a place and a heading in it that nobody knows before, and
its frame may be tilted by a little (`TILT_SIGMA_RAD`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.core.pose_graph.absolute_edges import AbsoluteEdges
from revisit.core.pose_graph.graph import Node

Array64 = NDArray[np.float64]

LEAST_SIGMA_M = 0.01
"""No place is surer."""

TILT_SIGMA_RAD = np.radians(1.0)
"""How level the frame of a map is: that of the first pose of its odometry."""

LEAST_ANCHORS = 4
"""Anchors that must agree before any counts; a heading that is told is as good as three."""

LEAST_SHARE = 0.5
"""Of the anchors of a frame must agree, at least."""

MOST_HEADING_SIGMA_RAD = np.radians(1.0)
"""The heading of a map must be as sure by the spread of its anchors before any counts."""

_ROUNDS = 30
"""Of the alignment with weights; it moves by less than a millimetre then."""


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
class Georeference:
    """The place of a map frame in the world: that of the component whose first session is `session`.

    T_world_map (4, 4); covariance (6, 6) of its tangent (x, y, z, rx, ry, rz) in the map frame, metres and radians;
    heading_sigma_rad by the spread of the `anchors` that hold it, of so many; residual_m, the root mean square of
    theirs across the ground.
    """

    session: str
    T_world_map: se3.Matrix4
    covariance: Array64
    heading_sigma_rad: float
    anchors: int
    of_anchors: int
    residual_m: float


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


def absolute_edges(anchors: Sequence[Anchor], rows: Mapping[Node, int]) -> AbsoluteEdges:
    """The anchors as terms of least squares. Those of one submap count as one together: their errors are alike."""
    beside = Counter(one.node for one in anchors)
    information = np.zeros((len(anchors), 6, 6))
    forwards, headings = np.tile([1.0, 0.0, 0.0], (len(anchors), 1)), np.zeros(len(anchors))
    for n, one in enumerate(anchors):
        share = 1.0 / beside[one.node]
        information[n, :3, :3] = share * np.linalg.inv(one.covariance + LEAST_SIGMA_M**2 * np.eye(3))
        if one.heading is not None:
            forwards[n], headings[n] = one.heading.forward_submap, one.heading.angle_rad
            information[n, 5, 5] = share / one.heading.sigma_rad**2
    return AbsoluteEdges(
        np.array([rows[one.node] for one in anchors], dtype=np.int64),
        np.reshape([one.point_submap for one in anchors], (-1, 3)),
        np.reshape([one.place_world for one in anchors], (-1, 3)),
        np.tile([0.0, 0.0, 1.0], (len(anchors), 1)),
        forwards,
        headings,
        information,
    )


def level(row: int, T_map_submap: se3.Matrix4) -> AbsoluteEdges:
    """The term that keeps a map level whose pose in `row` is `T_map_submap`: it says nothing of place and heading."""
    information = np.zeros((1, 6, 6))
    information[0, 3, 3] = information[0, 4, 4] = TILT_SIGMA_RAD**-2.0
    return AbsoluteEdges(
        np.array([row]), np.zeros((1, 3)), np.zeros((1, 3)), T_map_submap[None, 2, :3], np.eye(3)[:1], np.zeros(1),
        information,
    )  # fmt: skip


def aligned(edges: AbsoluteEdges, T_map_submap: Array64) -> se3.Matrix4:
    """T_world_map (4, 4), level, by which the anchors fit best to poses (n, 4, 4), roughly: wrong ones pull little.

    By Cauchy weights, whose scale is the median of the misfits: a drive that drifts fits nowhere as well as it states.
    """
    stated = edges.information[:, 0, 0] + edges.information[:, 1, 1]
    points, T_world_map = edges.points_at(T_map_submap), _level_fit(edges, T_map_submap, stated)
    for _ in range(_ROUNDS):
        misfits = np.linalg.norm(se3.apply(T_world_map, points) - edges.places, axis=1)
        scale = max(float(np.median(misfits)), LEAST_SIGMA_M)
        T_world_map = _level_fit(edges, T_map_submap, stated / (1.0 + (misfits / scale) ** 2))
    return T_world_map


def _level_fit(edges: AbsoluteEdges, T_map_submap: Array64, weights: Array64) -> se3.Matrix4:
    """The turn about z and the translation (4, 4) that take the points nearest to their places, with weights (k,), and
    the directions to their headings.
    """
    share, points, places = weights / weights.sum(), edges.points_at(T_map_submap), edges.places
    middle, target = share @ points, share @ places
    a, b = (points - middle)[:, :2], (places - target)[:, :2]
    turns, told = edges.headings - edges.headings_at(T_map_submap), 2.0 * edges.information[:, 5, 5] / weights.sum()
    cosine = share @ (a * b).sum(axis=1) + told @ np.cos(turns)
    sine = share @ (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) + told @ np.sin(turns)
    return _turned(float(np.arctan2(sine, cosine)), middle, target)


def _turned(angle: float, middle: Array64, target: Array64) -> se3.Matrix4:
    """The turn by an angle about z that takes point `middle` to `target`."""
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    T[:3, 3] = target - T[:3, :3] @ middle
    return T


def heading_sigma_rad(edges: AbsoluteEdges, T_world_submap: Array64) -> float:
    """How sure the heading of a stiff map is by the spread of its anchors; infinite where they do not tell it."""
    offsets = edges.points_at(T_world_submap)
    turned = np.stack([-offsets[:, 1], offsets[:, 0], np.zeros(len(offsets))], axis=1)
    jacobians = np.concatenate([np.tile(np.eye(3), (len(offsets), 1, 1)), turned[:, :, None]], axis=2)
    of_places = edges.information[:, :3, :3]
    known = np.einsum("kia,kij,kjb->ab", jacobians, of_places, jacobians)
    known[3, 3] += edges.information[:, 5, 5].sum()
    schur = known[3, 3] - known[3, :3] @ np.linalg.solve(known[:3, :3], known[:3, 3])
    return float(schur**-0.5) if schur > 0.0 else np.inf
