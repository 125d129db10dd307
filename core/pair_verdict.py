"""The verdict on a pair of submaps by itself: its types, which need no compiled code (paper III-E, end)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3


class RejectionReason(StrEnum):
    """Why a candidate is not a loop, or not yet."""

    DEGENERATE_PLACE = "DEGENERATE_PLACE"
    NO_COMMON_REGION = "NO_COMMON_REGION"
    DEGENERATE_ALIGNMENT = "DEGENERATE_ALIGNMENT"
    IMPLAUSIBLE_TILT = "IMPLAUSIBLE_TILT"
    LOW_OVERLAP = "LOW_OVERLAP"
    SEEN_THROUGH = "SEEN_THROUGH"
    LOW_SCORE = "LOW_SCORE"
    AMBIGUOUS = "AMBIGUOUS"
    AWAITS_CHAIN = "AWAITS_CHAIN"  # no rejection: it passed where places may repeat, and the drive goes on to decide
    PLACE_LOST = "PLACE_LOST"  # the stored place of a submap is damaged
    FAR_FROM_MAP = "FAR_FROM_MAP"  # a pair sought where its map has it was found elsewhere
    FAR_FROM_INITIAL_POSE = "FAR_FROM_INITIAL_POSE"  # the initial pose of a merge says otherwise


class Authority(StrEnum):
    """Weight of a pose from which registration starts."""

    DECIDES = "DECIDES"  # registration starts there alone; other poses that fit as well do not count against it
    COMPETES = "COMPETES"  # registration starts there alone; other poses that fit as well count against it
    HINT = "HINT"  # tried first, as one that competes; where the pair is not accepted from there, it is left out


@dataclass(frozen=True)
class InitialPose:
    """A T_match_query (4, 4) between the submap frames of a pair, from which its registration starts."""

    T_match_query: se3.Matrix4
    authority: Authority = Authority.DECIDES


@dataclass(frozen=True)
class Hypothesis:
    """A pose T_match_query (4, 4) of a pair, and the overlap 0..1 of the surfaces in it."""

    overlap: float
    T_match_query: se3.Matrix4


@dataclass(frozen=True)
class LoopMeasurement:
    """The evidence for a loop.

    similarity of the descriptors; inliers, keypoints that agree on the first guess of the pose, and inlier_ratio, their
    share of the correspondences; overlap 0..1 of the surfaces; contrast, how much of it is lost a few metres aside;
    seen_through 0..1, the share of a place's structure that the other looked through; rmse_m of the point-to-plane
    residuals; score 0..1 (`loop_score`);
    T_match_query (4, 4) maps points of the query submap's frame into the match submap's frame; covariance (6, 6) of its
    tangent (x, y, z, rx, ry, rz), metres and radians, in the match frame; rivals, other poses that fit about as well,
    best first, sought only where no more than a low score speaks against the loop; common_share, how much of what
    stands in the place with less of it lies where the other has seen, and enough_share, how much was asked for.
    """

    similarity: float
    inliers: int
    inlier_ratio: float
    overlap: float
    contrast: float
    seen_through: float
    rmse_m: float
    score: float
    T_match_query: se3.Matrix4
    covariance: NDArray[np.float64]
    rivals: tuple[Hypothesis, ...] = ()
    common_share: float = 0.0
    enough_share: float = 0.0


@dataclass(frozen=True)
class VerifiedLoop:
    """The two submaps show the same place."""

    measurement: LoopMeasurement


@dataclass(frozen=True)
class RejectedLoop:
    """The candidate is not accepted; the measurement is there where the geometry was looked at."""

    reason: RejectionReason
    measurement: LoopMeasurement | None = None
    message: str | None = None


PairVerdict: TypeAlias = VerifiedLoop | RejectedLoop
"""The verdict on a pair of submaps by itself."""
