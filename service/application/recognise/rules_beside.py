"""The rules that look at several loops at once, one after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from revisit.core.config import PipelineConfig, VerificationConfig
from revisit.service.application.recognise.look_alikes import not_standing_out
from revisit.service.application.recognise.loops_beside import (
    Beside,
    Registered,
    contradicted,
    supported,
    unsupported,
)
from revisit.service.application.recognise.outnumbered import outnumbered


def standing_out(loops: list[Beside], config: PipelineConfig) -> list[Beside]:
    """The loops of one query, those ambiguous that stand out from no other place."""
    return replaced(loops, not_standing_out(loops, config))


def decided(
    loops: list[Beside], rules: VerificationConfig, stride_m: float, register: Registered
) -> tuple[list[Beside], list[Beside]]:
    """The loops of a drive with the verdicts that they have beside each other; and those that have changed.

    `stride_m`: how far apart neighbouring submaps of the drive were begun.
    """
    stages: tuple[Callable[[list[Beside]], list[Beside]], ...] = (
        lambda told: outnumbered(told, stride_m),
        lambda told: contradicted(told, rules, stride_m),
        lambda told: unsupported(told, rules, stride_m),
        lambda told: supported(told, rules, stride_m, register),
    )
    changed: dict[tuple[int, int, int], Beside] = {}
    for stage in stages:
        found = stage(loops)
        loops = replaced(loops, found)
        changed.update({loop.key: loop for loop in found})
    return loops, list(changed.values())


def agreeing(loops: list[Beside], config: PipelineConfig) -> list[Beside]:
    """The candidates of a cloud that is of no drive with the verdicts that they have beside each other."""
    loops = standing_out(loops, config)
    loops = replaced(loops, outnumbered(loops, config.submap.stride))
    return replaced(loops, contradicted(loops, config.verification, config.submap.stride))


def replaced(loops: Sequence[Beside], changed: Iterable[Beside]) -> list[Beside]:
    """The loops, each of the changed ones with its new verdict."""
    known = {loop.key: loop for loop in changed}
    return [known.get(loop.key, loop) for loop in loops]
