"""The answer after a view: one pose, several that may be true, or none and why."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry.se3 import Matrix4


class RelocalisationState(StrEnum):
    """How far a conversation has come."""

    PLACED = "PLACED"  # one pose; nothing else may be true
    SEVERAL = "SEVERAL"  # poses that may be true; the rest of the probability is that of none of them
    UNKNOWN = "UNKNOWN"  # no pose; the reason says why


class UnknownReason(StrEnum):
    """Why no pose is told."""

    TOO_FEW_RETURNS = "TOO_FEW_RETURNS"  # the view cannot be described
    MAP_IS_EMPTY = "MAP_IS_EMPTY"  # the map has no submap to compare with
    NOT_YET = "NOT_YET"  # nothing fits so far, on a way too short to tell more
    PLACES_REPEAT = "PLACES_REPEAT"  # more places fit than can be told apart
    NOT_IN_MAP = "NOT_IN_MAP"  # nothing has fitted along `unsupported_way`


@dataclass(frozen=True)
class PossiblePose:
    """A pose of the newest view that may be true.

    T_frame_view (4, 4) in the frame of that name; covariance (6, 6) of (x, y, z, rx, ry, rz), metres and radians, about
    the view along the axes of the frame; views: those that agree with it; accepted: those of them with a pair that was
    accepted; along_m: the way along which they lie.
    """

    frame: str
    T_frame_view: Matrix4
    covariance: NDArray[np.float64]
    probability: float
    views: int
    accepted: int
    along_m: float


@dataclass(frozen=True)
class TellsApart:
    """A drive after which the possible poses would see unlike places.

    direction_rad: its direction in the frame of the newest view, 0 ahead, to the left positive; difference 0..1 of
    what they expect to see there.
    """

    direction_rad: float
    distance_m: float
    difference: float


@dataclass(frozen=True)
class RelocalisationAnswer:
    """The state after a view, its poses, most probable first, and the probability of none of them.

    PLACED has one pose and UNKNOWN none. The probabilities and `none_of_them` sum up to at most 1.
    """

    state: RelocalisationState
    poses: tuple[PossiblePose, ...]
    none_of_them: float
    travelled_m: float
    reason: UnknownReason | None = None
    tells_apart: TellsApart | None = None
