"""Loops of submaps that other places look like as much, or more (docs/decisions/0246, 0267).

In a field of equal rows any two submaps overlap well and lose little aside, for want of anything that ends: contrast is
too low, and nothing is accepted. One pair of hundreds passes, at a wrong place. What tells it from a right one is what
the other candidates of its query say: elsewhere on that drive they fit as well, but for contrast. In a street of equal
houses a wrong pair passes now and then that explains less of the submap than a house elsewhere, which is turned down
because two of its neighbours fit as well. Between drives of which nothing is known yet, any place elsewhere counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import PipelineConfig
from revisit.core.geometry.se3 import pose_matrix
from revisit.service.application.contract.events import AMBIGUOUS
from revisit.service.application.recognise.distinctiveness import are_one, spot_of
from revisit.service.application.recognise.loops_beside import LOOK_ALIKES, LOW_SCORE, OUTDONE, Beside

_LEAST, _SHARE = 4, 0.75
"""So many candidates elsewhere, and so large a share of them, must look alike."""

_WINDOWS = 3.0
"""Submaps of a drive farther apart than this many window lengths are elsewhere."""


def not_standing_out(judged: Sequence[Beside], config: PipelineConfig) -> list[Beside]:
    """Those of the accepted loops `judged`, all of one query, that do not stand out, with their verdict: AMBIGUOUS."""
    changed = []
    for loop in judged:
        if loop.accepted_by_itself and not loop.by_hand:
            doubt = _look_alikes(loop, judged, config) or _outdone(loop, judged, config, _looks_alike)
            if doubt:
                changed.append(_ambiguous(loop, doubt))
    return changed


def outdone_contacts(judged: Sequence[Beside], before: Sequence[Beside], config: PipelineConfig) -> list[Beside]:
    """Those of the accepted loops `judged`, all of one query, that no loop `before` on its drive prepares, and that a
    place elsewhere outdoes, whatever it was turned down for; with their verdict: AMBIGUOUS.
    """
    met = {one.match.session_number for one in before if one.verdict.accepted}
    changed = []
    for loop in judged:
        if loop.accepted_by_itself and not loop.by_hand and loop.match.session_number not in met:
            doubt = _outdone(loop, judged, config, _overlaps)
            if doubt:
                changed.append(_ambiguous(loop, doubt))
    return changed


def _look_alikes(loop: Beside, judged: Sequence[Beside], config: PipelineConfig) -> dict[str, Any]:
    """What the evidence says where nearly every other place of the drive looks like the submap; else nothing."""
    elsewhere = [one for one in judged if _is_elsewhere(one, loop, config)]
    alike = sum(_looks_alike(one, config) for one in elsewhere)
    if alike < max(_LEAST, _SHARE * len(elsewhere)):
        return {}
    words = f"it passed every check, but {alike} of {len(elsewhere)} other places of that drive look like it"
    return {LOOK_ALIKES: {"alike": alike, "elsewhere": len(elsewhere), "words": words}}


def _outdone(
    loop: Beside, judged: Sequence[Beside], config: PipelineConfig, counts: Callable[[Beside, PipelineConfig], bool]
) -> dict[str, Any]:
    """What the evidence says where a place elsewhere, on any drive, explains more of the submap; else nothing.

    Of the spot of `loop` the best candidate counts, of others each that `counts`.
    """
    others = [one for one in judged if one is not loop and one.verdict.T_match_query is not None]
    there = [_is_there(one, loop, config) for one in others]
    own = max([_overlap(loop), *(_overlap(one) for one, is_there in zip(others, there, strict=True) if is_there)])
    elsewhere = [one for one, is_there in zip(others, there, strict=True) if not is_there and counts(one, config)]
    best = max((_overlap(one) for one in elsewhere), default=None)
    if best is None or best < own:
        return {}
    words = f"it passed every check, but explains {own:.2f} of the submap, and a place elsewhere {best:.2f}"
    return {OUTDONE: {"overlap": own, "elsewhere": best, "words": words}}


def _is_there(one: Beside, loop: Beside, config: PipelineConfig) -> bool:
    """Whether a candidate may say the same spot as `loop`, by any of its poses."""
    if one.match.session_number != loop.match.session_number:
        return False
    poses = one.hypotheses or (one.verdict.T_match_query,)
    spot = spot_of(loop, loop.hypotheses[0])
    return any(pose is not None and are_one(spot_of(one, pose), spot, config.submap.stride) for pose in poses)


def _is_elsewhere(one: Beside, loop: Beside, config: PipelineConfig) -> bool:
    """Whether a candidate is another place of the drive that `loop` matches."""
    apart_m = float(np.linalg.norm(_position_m(one) - _position_m(loop)))
    return one.match.session_number == loop.match.session_number and apart_m > _WINDOWS * config.submap.tau


def _looks_alike(one: Beside, config: PipelineConfig) -> bool:
    """Whether a candidate passes but for its contrast, or for other poses that fit as well."""
    rules = config.verification
    return (
        not one.verdict.accepted
        and one.verdict.reason in (AMBIGUOUS, "DEGENERATE_ALIGNMENT")
        and _overlap(one) >= rules.min_overlap
        and one.verdict.score >= rules.min_score
    )


def _overlaps(one: Beside, config: PipelineConfig) -> bool:
    """Whether a candidate was aligned and overlaps enough, but fails."""
    aligned = one.verdict.reason in (AMBIGUOUS, "DEGENERATE_ALIGNMENT", LOW_SCORE)
    return not one.verdict.accepted and aligned and _overlap(one) >= config.verification.min_overlap


def _ambiguous(loop: Beside, doubt: dict[str, Any]) -> Beside:
    evidence = {**loop.verdict.evidence, **doubt}
    return replace(loop, verdict=replace(loop.verdict, accepted=False, reason=AMBIGUOUS, evidence=evidence))


def _overlap(loop: Beside) -> float:
    return float(_measured(loop).get("overlap", 0.0))


def _measured(loop: Beside) -> dict[str, Any]:
    measured: dict[str, Any] = loop.verdict.evidence.get("measurement", {})
    return measured


def _position_m(loop: Beside) -> NDArray[np.float64]:
    return np.asarray(pose_matrix(loop.match.T_odom_submap)[:3, 3])
