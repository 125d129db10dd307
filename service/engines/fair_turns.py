"""Fair turns: tenants share the workers' time, not their number of jobs.

A job costs its running time, however it ended. The next job is of the tenant that has had the least time; one that had
nothing to do is counted from where the others stand, so it saves up no claim (start-time fair queueing, Goyal, Vin and
Cheng 1996). All of it is kept with the jobs, so a worker that starts again changes nothing.
"""

from __future__ import annotations

from dataclasses import replace

from revisit.service.domain.identity import TenantId
from revisit.service.ports.job_queue import TenantTurns

ADVANCE_MS = 1000
"""Provisional cost of a claim until its run has ended: so several workers do not all take the same tenant's jobs."""

LEAST_MS = 1
"""Least cost of a job: another tenant's turn follows even the quickest one."""


class FairTurns:
    """The order of the tenants and the cost of a run."""

    def __init__(self, turns: TenantTurns) -> None:
        """Reads and writes `turns` in the transaction of the jobs."""
        self._turns = turns

    def order(self) -> list[TenantId]:
        """The tenants with unfinished jobs, the next one first."""
        floor_ms = self._turns.latest_start_ms()
        waiting = self._turns.waiting()
        waiting.sort(key=lambda turn: (max(turn.spent_ms, floor_ms), turn.spent_ms, turn.tenant))
        return [turn.tenant for turn in waiting]

    def begin(self, tenant: TenantId) -> None:
        """A job of the tenant begins."""
        turn = self._turns.of(tenant)
        start_ms = max(turn.spent_ms, self._turns.latest_start_ms())
        self._turns.keep(replace(turn, started_ms=start_ms, spent_ms=start_ms + ADVANCE_MS))

    def end(self, tenant: TenantId, ran_ms: int) -> None:
        """A job of the tenant has run for `ran_ms`."""
        turn = self._turns.of(tenant)
        self._turns.keep(replace(turn, spent_ms=turn.spent_ms - ADVANCE_MS + max(LEAST_MS, ran_ms)))
