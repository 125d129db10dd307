"""Optimising a map: what a worker does with the job, and how it comes into the queue."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from revisit.service.application.contract.clock import Clock, Instant
from revisit.service.application.contract.errors import Unavailable
from revisit.service.application.contract.identity import TenantId
from revisit.service.application.contract.job_queue import CANCELLED, Lease
from revisit.service.application.contract.map_optimiser import MapOptimiser
from revisit.service.application.contract.policy import Policy
from revisit.service.application.contract.records import JobRecord
from revisit.service.application.contract.states import LoopState, OperationKind, OperationState
from revisit.service.application.contract.transactions import Transactions, UnitOfWork
from revisit.service.application.mapping.graph_reading import read_task
from revisit.service.application.mapping.map_jobs import post_map_job, waiting_map_job
from revisit.service.application.mapping.progress import OperationCancelled, Progress
from revisit.service.application.mapping.version_commit import MAP_DELETED, VersionCommit
from revisit.service.failpoints import failpoint

NO_SUBMAPS = {"outcome": "the map holds no submaps"}
"""The result of a job that had nothing to optimise."""

LOOPS_A_DELAY = 500
"""For every so many accepted loops of a map new ones settle for one more delay before it is optimised by itself: the
larger a map, the longer it takes (docs/decisions/0090)."""

_READINGS = 5
"""How often a graph is read again that has lost a part while it was optimised."""


class MapOptimisation:
    """Runs the jobs that optimise maps; all calls block."""

    def __init__(self, transactions: Transactions, clock: Clock, policy: Policy, optimiser: MapOptimiser) -> None:
        """`optimiser` places the sessions to each other."""
        self._transactions = transactions
        self._clock = clock
        self._policy = policy
        self._optimiser = optimiser

    def run(self, lease: Lease) -> None:
        """Read the graph, optimise it, commit a version. Raises Unavailable where the graph changes all the time."""
        try:
            self._run(lease, Progress(self._transactions, self._clock, lease))
        except OperationCancelled:
            self._end(lease, CANCELLED)

    def _run(self, lease: Lease, progress: Progress) -> None:
        map_id = str(lease.job.payload["map_id"])
        read = partial(read_task, policy=self._policy, tenant=lease.job.tenant, map_id=map_id)
        for _ in range(_READINGS):
            progress("READ_MAP")
            task = self._transactions.read(read).result()
            if task is None or not task.graph.tracks:
                self._end(lease, MAP_DELETED if task is None else NO_SUBMAPS)
                return
            failpoint("optimise.after_read")
            optimised = self._optimiser.optimise(task.graph, progress)
            failpoint("optimise.after_solution")
            progress("COMMIT")
            now, now_ns = self._clock.instant(), self._clock.wall_ns()
            commit = VersionCommit(lease, task, optimised, self._policy, now, now_ns)
            if self._transactions.write(commit).result():
                return
        raise Unavailable("the map was changed again and again while it was optimised")

    def _end(self, lease: Lease, result: dict[str, Any]) -> None:
        now, now_ns = self._clock.instant(), self._clock.wall_ns()
        self._transactions.write(lambda uow: uow.queue.complete(lease, result, now, now_ns)).result()


def optimise_soon(
    uow: UnitOfWork,
    tenant: TenantId,
    map_id: str,
    policy: Policy,
    now: Instant,
    now_ns: int,
    *,
    decided: bool = False,
) -> None:
    """Let a map be optimised once its new loops have settled, where the service does that by itself.

    Enough of them must wait, or a person have `decided` on one, who does not wait for more.
    """
    least = policy.optimise_after_loops
    if not least or waiting_optimisation(uow, tenant, map_id) is not None:
        return
    accepted = {"map_id": map_id, "state": LoopState.ACCEPTED.value}
    if decided or least == 1 or uow.loops.count(tenant, **accepted, graph_state=None) >= least:
        delays = 1 if decided else 1 + uow.loops.count(tenant, **accepted) // LOOPS_A_DELAY
        due = Instant(now.epoch, now.ms + delays * policy.optimise_delay_ms)
        post_optimisation(uow, tenant, map_id, policy, now_ns, due)


def post_optimisation(
    uow: UnitOfWork, tenant: TenantId, map_id: str, policy: Policy, now_ns: int, due: Instant | None = None
) -> JobRecord:
    """Queue the job, not to be run before `due`."""
    return post_map_job(uow, tenant, map_id, OperationKind.OPTIMISE_MAP, policy, now_ns, due)


def waiting_optimisation(uow: UnitOfWork, tenant: TenantId, map_id: str) -> JobRecord | None:
    """The job of a map that no worker has taken yet."""
    return waiting_map_job(uow, tenant, map_id, OperationKind.OPTIMISE_MAP)


def brought_forward(uow: UnitOfWork, job: JobRecord) -> JobRecord:
    """The waiting job, due at once."""
    due = replace(job, lease_epoch="", not_before_ms=0)
    uow.jobs.replace(due)
    return due


def drop_waiting(uow: UnitOfWork, tenant: TenantId, map_id: str, result: dict[str, Any], now_ns: int) -> None:
    """End the waiting job of a map, if there is one, without running it."""
    job = waiting_optimisation(uow, tenant, map_id)
    if job is not None:
        uow.jobs.replace(replace(job, state=OperationState.DONE.value, result=result, finished_at_ns=now_ns))
