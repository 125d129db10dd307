"""Works side by side, whose kernel calls are done as one: so a device has the candidates of a query at once.

The method stays written for one pair. Each work has a thread, but only one runs at a time; a call of a kernel waits
until every other work waits too or has ended. Then calls of one kind are joined, in the order of the works, so that
what is computed together depends on the works alone and not on the clock.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from revisit.core.device.contract import (
    Agreement,
    Alignment,
    AlignmentRules,
    Array64,
    Contact,
    ContactNumbers,
    ContactRules,
    Correlation,
    Kernels,
    Shifts,
)

Result = TypeVar("Result")


@dataclass
class _Call:
    """A call that waits: of which work, of which method, and what comes of it."""

    seat: int
    method: str
    jobs: Sequence[Any]
    rules: Any
    answer: Future[list[Any]]


class Meeting:
    """Where works meet whose kernel calls are joined."""

    def __init__(self, kernels: Kernels, works: int) -> None:
        """`kernels` answer the calls of so many `works`."""
        self._kernels, self._running = kernels, works
        self._waiting: list[_Call] = []
        self._turn = threading.Condition()

    def run(self, work: Callable[[], Result]) -> Result:
        """Do `work` when it is its turn; others have theirs while it waits for a kernel."""
        with self._turn:
            try:
                return work()
            finally:
                self._running -= 1
                self._answer_when_all_wait()

    def ask(self, seat: int, method: str, jobs: Sequence[Any], rules: Any) -> list[Any]:
        """What the kernels' `method` makes of the jobs of the work `seat`. Raises what it raises."""
        call = _Call(seat, method, jobs, rules, Future())
        self._waiting.append(call)
        self._answer_when_all_wait()
        self._turn.wait_for(call.answer.done)
        return call.answer.result()

    def _answer_when_all_wait(self) -> None:
        if len(self._waiting) < self._running:
            return
        calls, self._waiting = sorted(self._waiting, key=lambda call: call.seat), []
        kinds: dict[tuple[str, Any], list[_Call]] = {}
        for call in calls:
            kinds.setdefault((call.method, call.rules), []).append(call)
        for (method, rules), alike in kinds.items():
            self._answer(method, rules, alike)
        self._turn.notify_all()

    def _answer(self, method: str, rules: Any, calls: list[_Call]) -> None:
        try:
            answers = iter(getattr(self._kernels, method)([job for call in calls for job in call.jobs], rules))
            for call in calls:
                call.answer.set_result([next(answers) for _ in call.jobs])
        except Exception as error:  # noqa: BLE001 - it belongs to the works that asked, each raises it
            for call in calls:
                call.answer.set_exception(error)


class Seat:
    """`Kernels` as one work of a meeting calls them."""

    def __init__(self, meeting: Meeting, number: int) -> None:
        self._meeting, self._number = meeting, number

    def align(self, jobs: Sequence[Alignment], rules: AlignmentRules) -> list[Array64]:
        """See `Kernels`."""
        return self._meeting.ask(self._number, "align", jobs, rules)

    def touch(self, jobs: Sequence[Contact], rules: ContactRules) -> list[ContactNumbers]:
        """See `Kernels`."""
        return self._meeting.ask(self._number, "touch", jobs, rules)

    def share(self, jobs: Sequence[Shifts], rules: ContactRules) -> list[NDArray[np.int64]]:
        """See `Kernels`."""
        return self._meeting.ask(self._number, "share", jobs, rules)

    def correlate(self, jobs: Sequence[Correlation], pixel: float) -> list[list[Agreement]]:
        """See `Kernels`."""
        return self._meeting.ask(self._number, "correlate", jobs, pixel)


def side_by_side(
    works: Sequence[Callable[[], Result]], kernels: Kernels, seated: Callable[[Kernels, Callable[[], Result]], Result]
) -> list[Result]:
    """What the works give, in their order; `seated` does one of them with the kernels of its seat. Raises what the
    first of the works raises that does.
    """
    meeting = Meeting(kernels, len(works))
    with ThreadPoolExecutor(len(works), "device") as threads:
        done = []
        for number, work in enumerate(works):
            run = partial(meeting.run, partial(seated, Seat(meeting, number), work))
            done.append(threads.submit(copy_context().run, run))
    return [future.result() for future in done]
