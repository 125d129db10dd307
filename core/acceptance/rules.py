"""Acceptance: the rules that judge the claims of a drive together, one after the other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from revisit.core.acceptance.alternatives import not_standing_out, outdone_contacts, without_twins
from revisit.core.acceptance.chain import with_waiting, without_waiting
from revisit.core.acceptance.claim import LoopClaim, Station, StationInMap
from revisit.core.acceptance.consistency import inconsistent
from revisit.core.acceptance.consistent_share import REACH_M, low_consistent_share
from revisit.core.acceptance.distinctiveness import with_distinctiveness
from revisit.core.acceptance.radio import radio_refuted
from revisit.core.acceptance.support import (
    VerifyNear,
    most_moved_m,
    with_own_odometry,
    with_support,
    without_lost_support,
)
from revisit.core.config import PipelineConfig, VerificationConfig
from revisit.core.geometry import se3
from revisit.core.pair_verdict import Hypothesis, RejectedLoop, RejectionReason


@dataclass(frozen=True)
class Drive:
    """A drive before one of its submaps: the claims that say anything there, and the way between two submaps, metres.

    Claims: of the `submaps_asked` submaps before, those accepted and not set aside since, those ambiguous, and those
    with too low a score.
    """

    claims: Sequence[LoopClaim]
    stride_m: float


@dataclass(frozen=True)
class Decided:
    """The claims of a query, judged together with the drive before it; and earlier claims that changed, by row."""

    new: list[LoopClaim]
    revised: dict[int, LoopClaim]


def submaps_asked(config: PipelineConfig) -> int:
    """How many submaps before one on its drive the rules ask about."""
    return math.ceil(REACH_M / config.submap.stride)


def stride_of_drive(query: Station, before: Sequence[Station], config: PipelineConfig) -> float:
    """How far apart neighbouring submaps of a drive were begun, metres: a client posts them where it likes."""
    apart = [
        float(np.linalg.norm(query.T_odom_submap[:3, 3] - one.T_odom_submap[:3, 3])) / (query.ordinal - one.ordinal)
        for one in before
    ]
    return max([config.submap.stride, *apart])


def accept(new: Sequence[LoopClaim], drive: Drive, config: PipelineConfig, verify_near: VerifyNear) -> Decided:
    """Judge the claims of one query together, and with the earlier claims of its drive.

    `verify_near` is asked by rows of the earlier claims followed by the new ones. Independent of the order of the
    claims, and of all drives but those of the pairs.
    """
    if not any(claim.hypotheses for claim in new):
        return Decided(list(new), {})
    known, rules = without_waiting(drive.claims), config.verification
    told = with_own_odometry(new, rules, drive.stride_m, lambda row, near: verify_near(len(known) + row, near))
    claims = [*known, *_beside_others(_with(new, told), known, config)]
    claims = _with(claims, low_consistent_share(claims, drive.stride_m))
    claims = _with(claims, inconsistent(claims, rules, drive.stride_m))
    claims = _with(claims, without_lost_support(claims, rules, drive.stride_m))
    claims = _with(claims, with_support(claims, rules, drive.stride_m, verify_near))
    claims = with_waiting(claims, drive.claims, known, drive.stride_m)
    before = len(drive.claims)
    revised = {row: claims[row] for row, one in enumerate(drive.claims) if claims[row] is not one}
    return Decided(with_distinctiveness(claims[before:], config.submap.stride), revised)


def _beside_others(new: Sequence[LoopClaim], known: Sequence[LoopClaim], config: PipelineConfig) -> list[LoopClaim]:
    """The claims of one query held against each other; those that radio refutes are no alternatives to others."""
    refuted = radio_refuted(new, known)
    rows = [row for row in range(len(new)) if row not in refuted]
    told = [new[row] for row in rows]
    told = _with(told, not_standing_out(told, config))
    told = _with(told, outdone_contacts(told, known, config))
    return _with(new, {**refuted, **dict(zip(rows, told, strict=True))})


def accept_cloud(
    claims: Sequence[LoopClaim], in_map: Sequence[StationInMap | None], config: PipelineConfig
) -> list[LoopClaim]:
    """Judge the claims of a cloud of no drive together; `in_map`: where the matches lie in the map.

    At least `config.loop.candidates` places should be claimed: a twin that nobody compares raises no doubt.
    """
    judged = _with(claims, without_twins(claims, in_map, config))
    judged = _with(judged, not_standing_out(judged, config))
    judged = _with(judged, low_consistent_share(judged, config.submap.stride))
    return _with(judged, inconsistent(judged, config.verification, config.submap.stride))


def accept_named(claim: LoopClaim, known: Sequence[LoopClaim], config: VerificationConfig) -> LoopClaim:
    """Judge the claim of a pair that a caller has named. It is held against no other pair.

    `known`: other claims on the same two submaps, whichever is the query, that are or were ambiguous. An ambiguous one
    keeps the pair ambiguous: its doubts stand, and its other poses are rivals; so does one that was accepted since, in
    another pose (docs/decisions/0371).
    """
    for own in known:
        if not claim.accepted or claim.measurement is None:
            break
        others = _other_poses(claim, own, config)
        if own.accepted and not others:
            continue
        measured = replace(claim.measurement, rivals=others)
        rejected = RejectedLoop(RejectionReason.AMBIGUOUS, measured)
        verdict = replace(claim.verdict, measurement=measured) if own.doubts else rejected
        claim = replace(claim, verdict=verdict, doubts=own.doubts)
    return claim


def _other_poses(claim: LoopClaim, own: LoopClaim, config: VerificationConfig) -> tuple[Hypothesis, ...]:
    """The poses of `own`, of an accepted claim its own alone, that are not that of `claim`, in the order of its pair,
    the best first.
    """
    if own.measurement is None or claim.T_match_query is None:
        return ()
    poses = [Hypothesis(own.overlap, own.measurement.T_match_query)]
    if not own.accepted:
        ruled_out = () if own.support is None else own.support.ruled_out
        poses += [*own.measurement.rivals, *(Hypothesis(own.overlap, pose) for pose in ruled_out)]
    if (own.query.drive, own.query.ordinal) == (claim.match.drive, claim.match.ordinal):
        poses = [Hypothesis(one.overlap, se3.inverse(one.T_match_query)) for one in poses]
    apart_m, turn_rad = most_moved_m(config), np.radians(config.support_turn)
    moved = [se3.inverse(claim.T_match_query) @ one.T_match_query for one in poses]
    is_other = [np.linalg.norm(T[:3, 3]) > apart_m or se3.rotation_angle(T) > turn_rad for T in moved]
    return tuple(one for one, other in zip(poses, is_other, strict=True) if other)


def best_loop(claims: Sequence[LoopClaim]) -> int | None:
    """The row of the loop with the highest score, the first of equal ones; None where no claim is a loop."""
    loops = [row for row, claim in enumerate(claims) if claim.accepted]
    return max(loops, key=lambda row: (claims[row].score, -row), default=None)


def _with(claims: Sequence[LoopClaim], changed: dict[int, LoopClaim]) -> list[LoopClaim]:
    """The claims, those in the rows that changed replaced."""
    return [changed.get(row, claim) for row, claim in enumerate(claims)]
