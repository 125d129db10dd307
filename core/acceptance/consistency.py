"""PAIRWISE_INCONSISTENT and ODOMETRY_INCONSISTENT: claims that others, or the odometry of their drive, contradict.

Loops between two drives must put them beside each other in one way, as near as odometry can tell; a loop within one
drive must agree with its own odometry (docs/decisions/0214).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from revisit.core.acceptance.claim import Doubt, Grounds, LoopClaim, by_matched_drive, says_a_pose
from revisit.core.acceptance.drive_loops import DriveLoops
from revisit.core.config import VerificationConfig
from revisit.core.geometry.se3 import Matrix4
from revisit.core.pair_verdict import Hypothesis


def inconsistent(claims: Sequence[LoopClaim], config: VerificationConfig, stride_m: float) -> dict[int, LoopClaim]:
    """The accepted claims that odometry or others contradict, by row, with that doubt and the poses said instead.

    `stride_m`: how far apart neighbouring submaps of a drive were begun.
    """
    changed = dict[int, LoopClaim]()
    for rows in by_matched_drive(claims, says_a_pose):
        speaking = [row for row in rows if claims[row].speaks]
        between = DriveLoops([claims[row] for row in speaking], stride_m, config)
        refuted = between.refuted
        for n in np.flatnonzero(refuted | between.contradicted()).tolist():
            claim = claims[speaking[n]]
            if claim.accepted_by_itself and not claim.by_hand:
                overlap = max((claims[row].overlap for row in speaking if row != speaking[n]), default=0.0)
                instead = [Hypothesis(overlap, pose) for pose in between.other_poses(n)]
                doubt, grounds = _against(claim, instead, by_odometry=bool(refuted[n]))
                changed[speaking[n]] = claim.doubted(doubt, grounds, instead)
    return changed


def _against(claim: LoopClaim, instead: Sequence[Hypothesis], *, by_odometry: bool) -> tuple[Doubt, Grounds]:
    if by_odometry:
        off_m = _apart_m(instead[0].T_match_query, claim.hypotheses[0])
        words = f"it passed every check, but is {off_m:.0f} m off by the odometry of its own drive"
        return Doubt.ODOMETRY_INCONSISTENT, Grounds(words)
    words = f"it passed every check, but so do loops beside it that say otherwise: {len(instead)} other poses"
    return Doubt.PAIRWISE_INCONSISTENT, Grounds(words)


def _apart_m(one: Matrix4, other: Matrix4) -> float:
    return float(np.linalg.norm(one[:3, 3] - other[:3, 3]))
