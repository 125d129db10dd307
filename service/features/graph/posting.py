"""How the optimisation of a map comes into the queue."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from revisit.service.domain.identity import TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import JobRecord
from revisit.service.domain.states import LoopState, OperationKind, OperationState
from revisit.service.features.graph.map_jobs import post_map_job, waiting_map_job
from revisit.service.ports.transactions import UnitOfWork

LOOPS_A_DELAY = 500
"""For every so many accepted loops of a map new ones settle for one more delay before it is optimised by itself: the
larger a map, the longer it takes."""


def optimise_soon(
    uow: UnitOfWork,
    tenant: TenantId,
    map_id: str,
    policy: Policy,
    now_ns: int,
    *,
    decided: bool = False,
) -> None:
    """Let a map be optimised once its new loops have settled, where the service does that by itself.

    Enough of them must wait, or a person have `decided` on one: that does not wait for more.
    """
    least = policy.optimise_after_loops
    if not least or waiting_optimisation(uow, tenant, map_id) is not None:
        return
    accepted = {"map_id": map_id, "state": LoopState.ACCEPTED.value}
    if decided or least == 1 or uow.loops.count(tenant, **accepted, graph_state=None) >= least:
        delays = 1 if decided else 1 + uow.loops.count(tenant, **accepted) // LOOPS_A_DELAY
        post_optimisation(uow, tenant, map_id, policy, now_ns, delays * policy.optimise_delay_ms)


def post_optimisation(
    uow: UnitOfWork, tenant: TenantId, map_id: str, policy: Policy, now_ns: int, delay_ms: int = 0
) -> JobRecord:
    """Queue the job, not to be run before `delay_ms` have passed."""
    return post_map_job(uow, tenant, map_id, OperationKind.OPTIMISE_MAP, policy, now_ns, delay_ms)


def waiting_optimisation(uow: UnitOfWork, tenant: TenantId, map_id: str, *, hold: bool = False) -> JobRecord | None:
    """The job of a map that no worker has taken yet, and that none takes while it is held."""
    job = waiting_map_job(uow, tenant, map_id, OperationKind.OPTIMISE_MAP)
    if job is None or not hold:
        return job
    held = uow.jobs.get(tenant, job.operation_id, hold=True)
    return held if held is not None and held.state == OperationState.QUEUED else None


def brought_forward(uow: UnitOfWork, job: JobRecord) -> JobRecord:
    """The waiting job, which is held, due at once."""
    due = replace(job, not_before_ms=0)
    uow.jobs.replace(due)
    return due


def drop_waiting(uow: UnitOfWork, tenant: TenantId, map_id: str, result: dict[str, Any], now_ns: int) -> None:
    """End the waiting job of a map, if there is one, without running it."""
    job = waiting_optimisation(uow, tenant, map_id, hold=True)
    if job is not None:
        uow.jobs.replace(replace(job, state=OperationState.DONE.value, result=result, finished_at_ns=now_ns))
