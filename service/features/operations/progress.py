"""Progress of a run, shown by its operation; and its cancellation."""

from __future__ import annotations

from functools import partial
from typing import Any

from revisit.service.ports.clock import Clock
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.transactions import Transactions, UnitOfWork

REPORT_EVERY_MS = 500
"""Each report is a write that other writers wait for."""


class OperationCancelled(Exception):  # an end that was asked for is no error
    """Somebody has asked the run to end."""


class Progress:
    """Reports of one run, stored at each new stage and now and then within it."""

    def __init__(self, transactions: Transactions, clock: Clock, lease: Lease) -> None:
        """`lease` is that of the run."""
        self._transactions = transactions
        self._clock = clock
        self._lease = lease
        self._stage = ""
        self._reported_ms = 0

    def __call__(self, stage: str, done: int = 0, total: int = 1) -> None:
        """`done` of `total` parts of a stage. Raises OperationCancelled, StaleLease."""
        now_ms = self._clock.monotonic_ms()
        if stage == self._stage and now_ms < self._reported_ms + REPORT_EVERY_MS:
            return
        self._stage, self._reported_ms = stage, now_ms
        report: dict[str, Any] = {"stage": stage, "done": done, "total": total}
        told = self._transactions.write(partial(_report, lease=self._lease, report=report), durable=False)
        if not told.result():
            raise OperationCancelled


def _report(uow: UnitOfWork, lease: Lease, report: dict[str, Any]) -> bool:
    return uow.queue.report(lease, report)
