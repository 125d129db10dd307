"""Loops of submaps that nearly every place of a drive looks like (docs/decisions/0246).

In a field of equal rows any two submaps overlap well and lose little aside, for want of anything that ends: contrast is
too low, and nothing is accepted. One pair of hundreds passes, at a wrong place. What tells it from a right one is what
the other candidates of its query say: elsewhere on that drive they fit as well, but for contrast. Several such loops
that agree support each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import PipelineConfig
from revisit.core.geometry.se3 import pose_matrix
from revisit.service.application.contract.events import AMBIGUOUS
from revisit.service.application.contract.recogniser import LoopVerdict
from revisit.service.application.recognise.loops_beside import LOOK_ALIKES, Beside

_LEAST, _SHARE = 4, 0.75
"""So many candidates elsewhere, and so large a share of them, must look alike."""

_WINDOWS = 3.0
"""Submaps of a drive farther apart than this many window lengths are elsewhere."""


def not_standing_out(judged: Sequence[Beside], config: PipelineConfig) -> list[Beside]:
    """Those of the accepted loops `judged`, all of one query, that do not stand out, with their verdict: AMBIGUOUS."""
    changed = []
    for loop in judged:
        if loop.accepted_by_itself and not loop.by_hand:
            elsewhere = [one for one in judged if _is_elsewhere(one, loop, config)]
            alike = sum(_looks_alike(one, config) for one in elsewhere)
            if alike >= max(_LEAST, _SHARE * len(elsewhere)):
                changed.append(replace(loop, verdict=_as_ambiguous(loop.verdict, alike, len(elsewhere))))
    return changed


def _is_elsewhere(one: Beside, loop: Beside, config: PipelineConfig) -> bool:
    """Whether a candidate is another place of the drive that `loop` matches."""
    apart_m = float(np.linalg.norm(_position_m(one) - _position_m(loop)))
    return one.match.session_number == loop.match.session_number and apart_m > _WINDOWS * config.submap.tau


def _looks_alike(one: Beside, config: PipelineConfig) -> bool:
    """Whether a candidate passes but for its contrast, or for other poses that fit as well."""
    measured, rules = _measured(one), config.verification
    return (
        not one.verdict.accepted
        and one.verdict.reason in (AMBIGUOUS, "DEGENERATE_ALIGNMENT")
        and measured.get("overlap", 0.0) >= rules.min_overlap
        and one.verdict.score >= rules.min_score
    )


def _as_ambiguous(verdict: LoopVerdict, alike: int, elsewhere: int) -> LoopVerdict:
    words = f"it passed every check, but {alike} of {elsewhere} other places of that drive look like it"
    evidence = {**verdict.evidence, LOOK_ALIKES: {"alike": alike, "elsewhere": elsewhere, "words": words}}
    return replace(verdict, accepted=False, reason=AMBIGUOUS, evidence=evidence)


def _measured(loop: Beside) -> dict[str, Any]:
    measured: dict[str, Any] = loop.verdict.evidence.get("measurement", {})
    return measured


def _position_m(loop: Beside) -> NDArray[np.float64]:
    return np.asarray(pose_matrix(loop.match.T_odom_submap)[:3, 3])
