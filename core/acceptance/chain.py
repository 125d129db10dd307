"""AWAITS_CHAIN: where places may repeat, a loop waits until its chain has decided.

The rules doubt some loops only submaps later, when others beside them contradict them or do not pass. Until then such a
loop would act: clients would hear of it, and the map would rest on it. Where pairs beside it show that places may
repeat, it waits; where a place is distinctive, nothing does (docs/decisions/0337).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from revisit.core.acceptance.claim import Doubt, Grounds, LoopClaim, Station, by_matched_drive, says_a_pose
from revisit.core.acceptance.consistent_share import REACH_M, explained_by_first
from revisit.core.acceptance.drive_loops import least_way_m, ways_m
from revisit.core.pair_verdict import RejectedLoop, RejectionReason

AGREEING, ALONG_M = 3, 30.0
"""So many loops that agree, of submaps over so many metres of the drive, decide."""

BESIDE_M = 30.0
"""Pairs of submaps within this way of the query show whether places may repeat."""

REPEATING = 0.5
"""From this share on of those that fit, places may repeat: it fits at several poses."""


def without_waiting(claims: Sequence[LoopClaim]) -> list[LoopClaim]:
    """The claims as the other rules see them: to them one that waits is a loop."""
    return [one.without(Doubt.AWAITS_CHAIN) if one.waits else one for one in claims]


def is_decided_by_way(query: Station, latest: Station, stride_m: float) -> bool:
    """Whether a drive has gone on so far from `query` to its submap `latest` that no later claim tells of it."""
    apart_m = np.linalg.norm(query.T_odom_submap[:3, 3] - latest.T_odom_submap[:3, 3])
    return bool(least_way_m(apart_m, latest.ordinal - query.ordinal, stride_m) >= REACH_M)


def with_waiting(
    claims: Sequence[LoopClaim], before: Sequence[LoopClaim], known: Sequence[LoopClaim], stride_m: float
) -> list[LoopClaim]:
    """The claims of a drive up to its last submap, those with the doubt that wait for their chain.

    The first of them are those of `before`, which the other rules have seen as `known`, `without_waiting`. One that was
    accepted once does not wait again.
    """
    latest = claims[-1].query
    asked = [
        row
        for row, one in enumerate(claims)
        if one.accepted and not one.by_hand and not (row < len(before) and before[row].accepted)
    ]
    asked = [row for row in asked if not is_decided_by_way(claims[row].query, latest, stride_m)]
    asked = _of_repeating(claims, asked, stride_m)
    waits = set(asked) - _decided(claims, asked, stride_m)
    found = list(claims)
    for row in waits:
        as_before = row < len(before) and before[row].waits and claims[row] is known[row]
        found[row] = before[row] if as_before else claims[row].doubted(Doubt.AWAITS_CHAIN, _GROUNDS)
    return found


def _of_repeating(claims: Sequence[LoopClaim], asked: Sequence[int], stride_m: float) -> list[int]:
    """Those of the rows `asked` for that lie where places may repeat."""
    if not asked:
        return []
    way_m = ways_m([one.query for one in claims], stride_m)
    fits = np.array([bool(one.hypotheses) for one in claims])
    several = np.array([_fits_several(one) for one in claims])
    found = []
    for row in asked:
        beside = fits & (way_m[row] <= BESIDE_M)
        if (beside & several).sum() >= REPEATING * beside.sum():
            found.append(row)
    return found


def _fits_several(claim: LoopClaim) -> bool:
    """Whether geometry alone fits a pair at several poses, decided since or not."""
    verdict = claim.verdict
    alone = isinstance(verdict, RejectedLoop) and verdict.reason == RejectionReason.AMBIGUOUS
    return alone or claim.support is not None or bool(claim.doubts)


def _decided(claims: Sequence[LoopClaim], asked: Sequence[int], stride_m: float) -> set[int]:
    """The rows `asked` for with a chain of loops that agree, long enough."""
    found, of_any = set[int](), frozenset(asked)
    for rows in by_matched_drive(claims, says_a_pose):
        chosen = [claims[row] for row in rows]
        of_drive = [n for n, row in enumerate(rows) if row in of_any]
        poses = [one.hypotheses[:1] for one in chosen]
        accepted = np.array([one.accepted for one in chosen])
        for n, agree in zip(of_drive, explained_by_first(chosen, of_drive, poses, stride_m), strict=True):
            if _is_chain([one.query for one, counts in zip(chosen, agree & accepted, strict=True) if counts], stride_m):
                found.add(rows[n])
    return found


def _is_chain(queries: Sequence[Station], stride_m: float) -> bool:
    """Whether loops of these submaps are enough, over a way that is long enough."""
    return len(queries) >= AGREEING and float(ways_m(queries, stride_m).max()) >= ALONG_M


_GROUNDS = Grounds("it passed every check, but places may repeat here: the drive goes on to tell")
