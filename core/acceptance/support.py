"""Support for claims that are ambiguous by geometry alone, from the claims beside them; and SUPPORT_LOST.

Where accepted claims beside an ambiguous one single out one of its poses, it is registered from there and
accepted. Where those are doubted later, it is ambiguous again (docs/decisions/0161).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from revisit.core.acceptance.claim import Doubt, Grounds, LoopClaim, Support, by_matched_drive, says_a_pose
from revisit.core.acceptance.drive_loops import DriveLoops, least_way_m
from revisit.core.acceptance.neighbour_support import NeighbourLoop, agrees, find_support, tells_apart
from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.pair_verdict import Hypothesis, InitialPose, PairVerdict, VerifiedLoop

VerifyNear = Callable[[int, InitialPose], PairVerdict]
"""Verify the pair of the claim in a row again, around a T_match_query (4, 4)."""


def most_moved_m(config: VerificationConfig) -> float:
    """How far a pair that is registered from one of several poses may end from it, metres: else it is another one."""
    return 0.5 * config.rival_distance


def without_lost_support(
    claims: Sequence[LoopClaim], config: VerificationConfig, stride_m: float
) -> dict[int, LoopClaim]:
    """The claims accepted for the sake of others that have lost these, by row, with that doubt.

    One that agrees must have been doubted since, and those that are left must not support the pose any more.
    """
    lost = dict[int, LoopClaim]()
    for rows in by_matched_drive(claims, says_a_pose):
        chosen = [claims[row] for row in rows]
        gone = [one.withdrawn for one in chosen]
        if not any(gone):
            continue
        between = DriveLoops(chosen, stride_m, config)
        for n, claim in enumerate(chosen):
            if not claim.decided_by_others or claim.by_hand or not between.agrees_with_any(n, gone):
                continue
            if claim.support is not None and claim.support.by_anchors:
                continue
            poses = (claim.hypotheses[0], *_ruled_out(claim))
            support = find_support(poses, between.neighbours(n), config)
            if support is None or support.hypothesis != 0:
                lost[rows[n]] = unsupported(claim, "loops beside it had decided it, and were contradicted since")
    return lost


def _ruled_out(claim: LoopClaim) -> tuple[Matrix4, ...]:
    return () if claim.support is None else claim.support.ruled_out


def unsupported(claim: LoopClaim, words: str) -> LoopClaim:
    """The claim without its support, for the reason in words: the poses that it had ruled out are rivals again."""
    grounds = Grounds(words)
    rivals = [Hypothesis(claim.overlap, pose) for pose in _ruled_out(claim)]
    return replace(claim, support=None).doubted(Doubt.SUPPORT_LOST, grounds, rivals)


def with_support(
    claims: Sequence[LoopClaim], config: VerificationConfig, stride_m: float, verify_near: VerifyNear
) -> dict[int, LoopClaim]:
    """The ambiguous claims that the others decide, by row, as they are then."""
    decided = dict[int, LoopClaim]()
    for rows in by_matched_drive(claims, says_a_pose):
        chosen = [claims[row] for row in rows]
        between = DriveLoops(chosen, stride_m, config)
        for n, claim in enumerate(chosen):
            if not (claim.ambiguous and between.has_accepted_neighbour(n)):
                continue
            support = find_support(claim.hypotheses, between.neighbours(n), config)
            if support is None:
                continue
            others = _others(claim.hypotheses, support.hypothesis)
            told = Support(support.anchors, support.agreeing, support.along_m, others)
            found = _registered(rows[n], claim, support.hypothesis, told, config, verify_near)
            if found is not None:
                decided[rows[n]] = found
    return decided


def with_own_odometry(
    claims: Sequence[LoopClaim], config: VerificationConfig, stride_m: float, verify_near: VerifyNear
) -> dict[int, LoopClaim]:
    """The claims within one drive that several poses fit and its odometry decides, by row, as they are then.

    It decides over ways alone over which it carries the poses of other loops, too, and as surely: poses that lie nearer
    to each other than it may err by then stay ambiguous (docs/decisions/0364).
    """
    decided = dict[int, LoopClaim]()
    for row, claim in enumerate(claims):
        if not (claim.of_one_drive and claim.ambiguous) or claim.doubts or claim.by_hand:
            continue
        own = _own_odometry(claim, stride_m)
        if own.way_m > config.support_reach:
            continue
        rows = [n for n, pose in enumerate(claim.hypotheses) if agrees(pose, own, config)]
        if len(rows) != 1:
            continue
        others = _others(claim.hypotheses, rows[0])
        if tells_apart(claim.hypotheses[rows[0]], others, own, config):
            told = Support(0, 0, own.way_m, others, own_odometry=True)
            found = _registered(row, claim, rows[0], told, config, verify_near)
            if found is not None:
                decided[row] = found
    return decided


def _own_odometry(claim: LoopClaim, stride_m: float) -> NeighbourLoop:
    """The pose of a claim within one drive by its odometry, with the way between its submaps."""
    T_match_query = se3.inverse(claim.match.T_odom_submap) @ claim.query.T_odom_submap
    apart_m = float(np.linalg.norm(T_match_query[:3, 3]))
    way_m = float(least_way_m(apart_m, claim.query.ordinal - claim.match.ordinal, stride_m))
    return NeighbourLoop(True, (T_match_query,), 0.0, 0.0, way_m)


def _others(poses: Sequence[Matrix4], row: int) -> tuple[Matrix4, ...]:
    return (*poses[:row], *poses[row + 1 :])


def _registered(
    row: int,
    claim: LoopClaim,
    chosen: int,
    support: Support,
    config: VerificationConfig,
    verify_near: VerifyNear,
) -> LoopClaim | None:
    """The claim around the pose that has support; None where it is not accepted there, or moved away from it."""
    hypothesis = claim.hypotheses[chosen]
    verdict = verify_near(row, InitialPose(hypothesis))
    if not isinstance(verdict, VerifiedLoop):
        return None
    moved_m = float(np.linalg.norm(verdict.measurement.T_match_query[:3, 3] - hypothesis[:3, 3]))
    if moved_m > most_moved_m(config):
        return None
    asked_anew = claim.without(Doubt.SUPPORT_LOST, Doubt.LOW_CONSISTENT_SHARE)
    return replace(asked_anew, verdict=verdict, support=support)
