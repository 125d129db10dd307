"""Accepted loops at a pose that most of the pairs it explains do not pass at are AMBIGUOUS (docs/decisions/0280)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from revisit.core.evident_share import EvidentShare, TestedPair, evident_shares
from revisit.core.geometry.se3 import Matrix4
from revisit.service.application.contract.events import AMBIGUOUS
from revisit.service.application.recognise.loops_beside import (
    CONTRADICTED,
    LOOK_ALIKES,
    LOW_SCORE,
    OUTDONE,
    OUTNUMBERED,
    Beside,
    by_drives,
    on_drive,
)

_NOT_STANDING_OUT = LOOK_ALIKES, OUTDONE
"""Members of the evidence of a loop that stands out from no other place."""


def outnumbered(loops: Sequence[Beside], stride_m: float) -> list[Beside]:
    """Those of the loops that passed by themselves whose verdict changes, with what it is then.

    Of the loops that the same pose explains a share, itself included, must have passed by themselves: else a loop is
    AMBIGUOUS, until more of them have. `stride_m`: how far apart neighbouring submaps of a drive were begun.
    """
    changed = []
    for told in by_drives(loop for loop in loops if _poses(loop)):
        asked = [row for row, one in enumerate(told) if one.accepted_by_itself or _is_doubted(one)]
        if not asked:
            continue
        pairs = [TestedPair(on_drive(one.query), on_drive(one.match), _poses(one), _is_evident(one)) for one in told]
        for row, share in zip(asked, evident_shares(pairs, asked, stride_m), strict=True):
            loop = told[row]
            if share.is_enough and not loop.verdict.accepted:
                changed.append(_believed(loop))
            elif not share.is_enough and loop.verdict.accepted and not loop.by_hand:
                changed.append(_doubted(loop, share))
    return changed


def _poses(loop: Beside) -> tuple[Matrix4, ...]:
    """The poses that fit a loop, that of a low score included."""
    if loop.verdict.T_match_query is not None and loop.verdict.reason == LOW_SCORE:
        return (loop.verdict.T_match_query,)
    return loop.hypotheses


def _is_evident(loop: Beside) -> bool:
    """Whether a pair passed every check by itself, and stood out from other places."""
    told = loop.verdict.evidence
    if any(name in told for name in _NOT_STANDING_OUT):
        return False
    return loop.accepted_by_itself or OUTNUMBERED in told or CONTRADICTED in told


def _is_doubted(loop: Beside) -> bool:
    """Whether a loop is ambiguous for this rule alone."""
    told = loop.verdict.evidence
    return (
        loop.ambiguous and OUTNUMBERED in told and not any(name in told for name in (CONTRADICTED, *_NOT_STANDING_OUT))
    )


def _believed(loop: Beside) -> Beside:
    evidence = {name: value for name, value in loop.verdict.evidence.items() if name != OUTNUMBERED}
    return replace(loop, verdict=replace(loop.verdict, accepted=True, reason=None, evidence=evidence))


def _doubted(loop: Beside, share: EvidentShare) -> Beside:
    words = (
        f"it passed every check, but of {share.pairs} pairs of submaps that its pose explains only {share.evident} did:"
        f" of many that look alike, some pass by chance"
    )
    told = {OUTNUMBERED: {"evident": share.evident, "pairs": share.pairs, "words": words}}
    evidence = {**loop.verdict.evidence, **told}
    return replace(loop, verdict=replace(loop.verdict, accepted=False, reason=AMBIGUOUS, evidence=evidence))
