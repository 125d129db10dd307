"""A pair that is tested again from where a map, or anchors, have its two submaps: a loop there, or none."""

from __future__ import annotations

import numpy as np

from revisit.core.acceptance.support import most_moved_m
from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.pair_verdict import PairVerdict, RejectedLoop, RejectionReason, VerifiedLoop

MOST_MOVED_M = 3.0
"""In a scene of scale 1: a pose farther from the map's is another place. Also the largest standard deviation of the
relative pose in the map.
"""


def accept_near(verdict: PairVerdict, T_match_query: Matrix4, most_moved_m: float) -> PairVerdict:
    """The verdict on a pair tested from T_match_query (4, 4) of the map: FAR_FROM_MAP where it passes elsewhere."""
    if not isinstance(verdict, VerifiedLoop):
        return verdict
    moved = se3.inverse(T_match_query) @ verdict.measurement.T_match_query
    if float(np.linalg.norm(moved[:3, 3])) <= most_moved_m:
        return verdict
    return RejectedLoop(RejectionReason.FAR_FROM_MAP, verdict.measurement)


def accept_chosen(verdict: PairVerdict, T_match_query: Matrix4, config: VerificationConfig) -> PairVerdict:
    """The verdict on a pair tested from the one of its poses T_match_query (4, 4) that anchors chose.

    The score says how sure the surfaces alone are that it is this place; here anchors are (docs/decisions/0362). All
    other checks stand, and a pair that ends at another pose is none.
    """
    measured = verdict.measurement
    if isinstance(verdict, RejectedLoop) and verdict.reason is RejectionReason.LOW_SCORE and measured is not None:
        verdict = VerifiedLoop(measured)
    return accept_near(verdict, T_match_query, most_moved_m(config))
