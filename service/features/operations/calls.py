"""Operations: jobs as clients see them; get, list and wait for them."""

from __future__ import annotations

import asyncio
import time
from dataclasses import replace
from functools import partial
from typing import Any

from revisit.core.errors import BadField
from revisit.service.capacity.call_slots import Wait, waiting
from revisit.service.domain import limits
from revisit.service.domain.errors import NoAnswer, error_of
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import JobRecord
from revisit.service.domain.states import OperationKind, OperationState
from revisit.service.features.operations.progress import portion_of
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Page, PageRequest, as_it_is
from revisit.service.features.waiting.shared_poll import SharedPoll
from revisit.service.ports.job_queue import CANCELLED
from revisit.service.ports.storage import discard, require_job
from revisit.service.ports.transactions import UnitOfWork

_PAUSE_S = (0.02, 0.25)

CANCELLABLE = (
    OperationKind.OPTIMISE_MAP, OperationKind.MERGE_MAP, OperationKind.RECALL_LOOPS, OperationKind.PREVIEW_ANCHORS,
)  # fmt: skip
"""The kinds of operations that look, while they run, whether they are to end."""


class Operations:
    """Get, list and wait for operations."""

    def __init__(self, context: CallContext) -> None:
        """Waiting ends when the service stops."""
        self._context = context
        self._polls = SharedPoll(context.storage, _unfinished)

    async def get(self, tenant: TenantId, operation_id: str) -> JobRecord:
        """Raises NotFound."""
        return await self._context.storage.read(partial(require_job, tenant=tenant, operation_id=operation_id))

    async def list(self, tenant: TenantId, page: PageRequest, state: OperationState | None = None) -> Page[JobRecord]:
        """The tenant's operations, oldest first."""
        only: dict[str, str] = {} if state is None else {"state": state.value}
        return await self._context.lists.page(
            tenant,
            page,
            lambda uow, after, limit: uow.jobs.find(tenant, after=after, limit=limit, **only),
            as_it_is,
        )

    async def cancel(self, tenant: TenantId, operation_id: str) -> JobRecord:
        """End an operation that optimises or merges maps: at once where it waits, else at its next step.

        One that has ended is left as it is. Raises NotFound; BadField for one of another kind; Draining.
        """
        self._context.admission.require_running()
        job = await self._context.storage.write(partial(self._cancel, tenant=tenant, operation_id=operation_id))
        kept = portion_of(job) if job.done else None
        if kept is not None:
            await asyncio.to_thread(discard, self._context.storage.blobs, kept)
        return job

    def _cancel(self, uow: UnitOfWork, tenant: TenantId, operation_id: str) -> JobRecord:
        job = require_job(uow, tenant, operation_id, hold=True)
        if job.kind not in CANCELLABLE:
            raise BadField("only what optimises or merges maps can be cancelled", field="name")
        if job.state == OperationState.QUEUED:
            done, now_ns = OperationState.DONE.value, self._context.clock.wall_ns()
            job = replace(job, cancel_requested=True, state=done, result=CANCELLED, finished_at_ns=now_ns)
            uow.jobs.replace(job)
        elif job.state == OperationState.RUNNING and not job.cancel_requested:
            job = replace(job, cancel_requested=True)
            uow.jobs.replace(job)
        return job

    def require_result(self, waited_for: JobRecord, unanswered: str) -> dict[str, Any]:
        """The result of an operation. Raises the worker's error; NoAnswer, or Draining, where it has not ended."""
        if waited_for.failure_code is not None:
            raise error_of(waited_for.failure_code, waited_for.failure_message or "")
        if waited_for.result is None:
            self._context.admission.require_running()
            raise NoAnswer(unanswered)
        return waited_for.result

    async def wait(self, tenant: TenantId, operation_id: str, timeout_s: float) -> JobRecord:
        """The operation once it has ended, or as it stands after `timeout_s` (at most 60). Raises NotFound.

        Returns early, as it stands, when the service stops or the client has left. Raises RateLimited where too many
        wait.
        """
        operation = await self.get(tenant, operation_id)
        if operation.done or timeout_s <= 0.0:
            return operation
        with waiting() as wait:
            await self._wait(tenant, operation_id, min(timeout_s, limits.WAIT_S.most), wait)
        return await self.get(tenant, operation_id)

    async def _wait(self, tenant: TenantId, operation_id: str, timeout_s: float, wait: Wait) -> None:
        """Return once the operation has ended, or nobody waits any longer, or so many seconds are over."""
        deadline, pause = time.monotonic() + timeout_s, _PAUSE_S[0]
        while (left := deadline - time.monotonic()) > 0 and not (self._context.admission.stopping or wait.abandoned):
            if await self._polls.has_come(tenant, operation_id, min(pause, left)):
                return
            pause = min(pause * 1.5, _PAUSE_S[1])


def _unfinished(uow: UnitOfWork, tenant: TenantId, operation_ids: frozenset[str]) -> frozenset[str]:
    return uow.jobs.unfinished(tenant, operation_ids)
