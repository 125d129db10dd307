"""The gateway's chores beside answering, each in its own rhythm, for as long as it runs."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import structlog

from revisit.core.errors import RevisitError

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class Chore:
    """Work that is done at the start and again `every_s` seconds after it has ended, the second time sooner.

    `at_end`: once more at the end. `close` ends tasks that the work has left running.
    """

    name: str
    every_s: float
    work: Callable[[], Awaitable[None]]
    at_end: bool = False
    close: Callable[[], Awaitable[None]] | None = None


class Upkeep:
    """Runs chores until it is stopped; one that fails is tried again in its next turn."""

    def __init__(self, chores: Sequence[Chore]) -> None:
        """Nothing runs before `start`."""
        self._chores = chores
        self._tasks: list[asyncio.Task[None]] = []

    def start(self) -> None:
        """Begin; returns at once."""
        for number, chore in enumerate(self._chores, 1):
            repeated = _repeat(chore, number / len(self._chores))
            self._tasks.append(asyncio.create_task(repeated, name=chore.name))

    async def stop(self) -> None:
        """End every chore where it stands; those that are due `at_end` are done once more."""
        for task in self._tasks:
            task.cancel()
        for task in self._tasks:
            with suppress(asyncio.CancelledError):
                await task
        for chore in self._chores:
            if chore.at_end:
                await _once(chore)
            if chore.close is not None:
                await chore.close()


async def _repeat(chore: Chore, phase: float) -> None:
    """The first pause is this part of the rhythm, another one for each chore: else all would always come at once."""
    await _once(chore)
    await asyncio.sleep(phase * chore.every_s)
    while True:
        await _once(chore)
        await asyncio.sleep(chore.every_s)


async def _once(chore: Chore) -> None:
    try:
        await chore.work()
    except RevisitError as error:
        log.warning("chore_failed", chore=chore.name, reason=error.reason)
    except Exception:  # a defect in one chore must not end the gateway
        log.exception("chore_crashed", chore=chore.name)
