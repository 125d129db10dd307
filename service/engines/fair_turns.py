"""Fair turns: tenants share the workers' time, not their number of jobs.

A job costs its running time, however it ended. The next job is of the tenant that has had the least time; one that had
nothing to do is counted from where the others stand, so it saves up no claim (start-time fair queueing, Goyal, Vin and
Cheng 1996). All of it is kept with the jobs, so a worker that starts again changes nothing: a row a tenant and worker,
so that no two workers wait for each other's.
"""

from __future__ import annotations

from dataclasses import replace

from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import TurnRecord
from revisit.service.ports.job_queue import Standing, TenantTurns

ADVANCE_MS = 1000
"""Provisional cost of a claim until its run has ended: so several workers do not all take the same tenant's jobs."""

GONE = ""
"""Id under which the time of workers is kept that are gone."""

LEAST_MS = 1
"""Least cost of a job: another tenant's turn follows even the quickest one."""


class FairTurns:
    """The order of the tenants and the cost of a run."""

    def __init__(self, turns: TenantTurns) -> None:
        """Reads and writes `turns` in the transaction of the jobs."""
        self._turns = turns

    def standing(self) -> Standing:
        """See `TenantTurns`."""
        return self._turns.standing()

    @staticmethod
    def order(standing: Standing) -> list[TurnRecord]:
        """The tenants with unfinished jobs, the next one first; those behind are lifted to where the last job began."""
        floor_ms = standing.latest_start_ms
        order = sorted(standing.turns, key=lambda turn: (max(turn.spent_ms, floor_ms), turn.spent_ms, turn.tenant))
        return [replace(turn, started_ms=max(turn.spent_ms, floor_ms)) for turn in order]

    def begin(self, turn: TurnRecord, worker_id: str) -> None:
        """A worker begins a job of the tenant whose turn `order` says it is."""
        lifted_ms = turn.started_ms - turn.ran_ms if turn.started_ms > turn.spent_ms else 0
        self._turns.add(replace(turn, ran_ms=ADVANCE_MS, lifted_ms=lifted_ms), worker_id)

    def end(self, tenant: TenantId, worker_id: str | None, ran_ms: int) -> None:
        """A job of the tenant has run for `ran_ms` on a worker."""
        self._turns.add(TurnRecord(tenant, ran_ms=max(LEAST_MS, ran_ms) - ADVANCE_MS), worker_id or GONE)

    def mend(self) -> None:
        """Begin anew where what tenants have had cannot be read."""
        self._turns.mend()

    def forget(self, worker_id: str) -> None:
        """The worker is gone: its time is kept with that of all who are."""
        for turn in self._turns.of_worker(worker_id):
            self._turns.add(turn, GONE)
        self._turns.forget(worker_id)
