"""Made-up verdicts on pairs of submaps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from revisit.core.geometry.se3 import Matrix4
from revisit.core.verification import Hypothesis, LoopMeasurement, RejectedLoop, RejectionReason, VerifiedLoop

NOT_MEASURED = np.full((6, 6), np.nan)


def measured(
    T_match_query: Matrix4,
    score: float = 0.9,
    *,
    overlap: float = 0.6,
    contrast: float = 0.2,
    rivals: Sequence[Matrix4] = (),
    covariance: np.ndarray = NOT_MEASURED,
) -> LoopMeasurement:
    """What was measured of a pair at a pose; `rivals` overlap as much."""
    others = tuple(Hypothesis(overlap, pose) for pose in rivals)
    return LoopMeasurement(0.9, 30, 0.5, overlap, contrast, 0.0, 0.05, score, T_match_query, covariance, others)


def verified(T_match_query: Matrix4, score: float = 0.9, **told) -> VerifiedLoop:
    """A pair that passed."""
    return VerifiedLoop(measured(T_match_query, score, **told))


def ambiguous(poses: Sequence[Matrix4], score: float = 0.9, **told) -> RejectedLoop:
    """A pair that several poses fit, the best first."""
    return rejected("AMBIGUOUS", poses[0], score, rivals=poses[1:], **told)


def rejected(
    reason: str = "LOW_OVERLAP", T_match_query: Matrix4 | None = None, score: float = 0.1, **told
) -> RejectedLoop:
    """A pair that did not pass, with a measurement where there is a pose."""
    found = None if T_match_query is None else measured(T_match_query, score, **told)
    return RejectedLoop(RejectionReason(reason), found)
