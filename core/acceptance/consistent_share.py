"""LOW_CONSISTENT_SHARE: of the pairs that one pose of two drives explains, too few have passed by themselves.

Where a place repeats, some of many pairs pass by chance at a wrong pose, and the others that the same pose explains do
not: another pose fits them as well, or their score is too low. At the right pose of a place that is like no other,
nearly all pass (docs/decisions/0267).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.acceptance.claim import Doubt, Grounds, LoopClaim, by_matched_drive
from revisit.core.acceptance.drive_loops import frames_between, ways_m
from revisit.core.geometry.se3 import Matrix4
from revisit.core.pair_verdict import RejectionReason

LEAST_EVIDENT = 0.36
"""Chance gives a smaller share where places look alike."""

REACH_M = 80.0
"""Pairs of which the queries lie farther apart along their drive say nothing of each other."""

_TOLERANCE_M = 1.0
_DRIFT = 0.02
_TURN = np.radians(8.0)


@dataclass(frozen=True)
class EvidentShare:
    """Of the pairs that the first pose of one explains, itself among them: how many are evident, how many there are."""

    evident: int
    pairs: int

    @property
    def is_enough(self) -> bool:
        """Whether more pass than chance would let."""
        return self.evident >= LEAST_EVIDENT * self.pairs


def low_consistent_share(claims: Sequence[LoopClaim], stride_m: float) -> dict[int, LoopClaim]:
    """The claims that passed by themselves whose doubt of this kind comes or goes, by row.

    Of the pairs that the same pose explains, itself included, a share must have passed by themselves. `stride_m`: how
    far apart neighbouring submaps of a drive were begun.
    """
    changed = dict[int, LoopClaim]()
    for rows in by_matched_drive(claims, lambda claim: bool(_poses(claim))):
        chosen = [claims[row] for row in rows]
        asked = [n for n, one in enumerate(chosen) if one.accepted_by_itself or _is_doubted_by_share_alone(one)]
        for n, share in zip(asked, evident_shares(chosen, asked, stride_m), strict=True):
            claim = chosen[n]
            if share.is_enough and not claim.accepted:
                changed[rows[n]] = claim.without(Doubt.LOW_CONSISTENT_SHARE)
            elif not share.is_enough and claim.accepted and not claim.by_hand:
                changed[rows[n]] = claim.doubted(Doubt.LOW_CONSISTENT_SHARE, _grounds(share))
    return changed


def _poses(claim: LoopClaim) -> tuple[Matrix4, ...]:
    """The poses that fit a claim, that of a low score included."""
    if claim.T_match_query is not None and claim.reason == RejectionReason.LOW_SCORE:
        return (claim.T_match_query,)
    return claim.hypotheses


def _is_evident(claim: LoopClaim) -> bool:
    """Whether a pair passed every check by itself, and stood out from other places."""
    if Doubt.PERCEPTUAL_ALIAS in claim.doubts or Doubt.BETTER_ALTERNATIVE in claim.doubts:
        return False
    doubted = Doubt.LOW_CONSISTENT_SHARE in claim.doubts or Doubt.PAIRWISE_INCONSISTENT in claim.doubts
    return claim.accepted_by_itself or doubted


def _is_doubted_by_share_alone(claim: LoopClaim) -> bool:
    """Whether a claim would be accepted but for this rule."""
    others = Doubt.PAIRWISE_INCONSISTENT, Doubt.PERCEPTUAL_ALIAS, Doubt.BETTER_ALTERNATIVE
    doubted = claim.ambiguous and Doubt.LOW_CONSISTENT_SHARE in claim.doubts
    return doubted and not any(one in claim.doubts for one in others)


def _grounds(share: EvidentShare) -> Grounds:
    words = (
        f"it passed every check, but of {share.pairs} pairs of submaps that its pose explains only {share.evident} did:"
        f" of many that look alike, some pass by chance"
    )
    return Grounds(words, {"evident": share.evident, "pairs": share.pairs})


def evident_shares(claims: Sequence[LoopClaim], asked: Sequence[int], stride_m: float) -> list[EvidentShare]:
    """The share at the first pose of each of the claims `asked` for, by their rows; all of one matched drive.

    `stride_m`: how far apart neighbouring submaps of the query's drive were begun.
    """
    evident = np.array([_is_evident(one) for one in claims])
    explained = explained_by_first(claims, asked, [_poses(claim) for claim in claims], stride_m)
    return [EvidentShare(int((one & evident).sum()), int(one.sum())) for one in explained]


def explained_by_first(
    claims: Sequence[LoopClaim], asked: Sequence[int], poses: Sequence[Sequence[Matrix4]], stride_m: float
) -> list[NDArray[np.bool_]]:
    """Which claims (n,) the first pose of each of those `asked` for explains by one of their `poses`, by odometry.

    Of queries that lie no more than `REACH_M` along the drive from that of the one; all of one matched drive.
    """
    if not asked:
        return []
    by_claim = frames_between(claims, poses)
    frames, owners = np.concatenate(by_claim), np.repeat(np.arange(len(claims)), [len(said) for said in by_claim])
    way_m = ways_m([one.query for one in claims], stride_m)
    position_m = np.array([one.query.T_odom_submap[:3, 3] for one in claims])[owners]
    found = []
    for row in asked:
        explained = np.zeros(len(claims), dtype=bool)
        explained[owners[_agree(frames, by_claim[row][0], position_m, way_m[row, owners])]] = True
        found.append(np.asarray(explained & (way_m[row] <= REACH_M)))
    return found


def _agree(
    frames: NDArray[np.float64], frame: NDArray[np.float64], position_m: NDArray[np.float64], way_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Which of `frames` (h, 4, 4) put their queries, at `position_m` (h, 3), where `frame` does, `way_m` (h,) away."""
    apart = np.einsum("hab,hb->ha", frames[:, :3, :3] - frame[:3, :3], position_m) + frames[:, :3, 3] - frame[:3, 3]
    traces = np.einsum("hab,ab->h", frames[:, :3, :3], frame[:3, :3])
    near = np.linalg.norm(apart, axis=1) < _TOLERANCE_M + _DRIFT * way_m
    return np.asarray(near & (traces > 1.0 + 2.0 * np.cos(_TURN)))
