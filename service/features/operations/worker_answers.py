"""Questions that workers answer: a job is posted, its result is waited for, and a job that nobody waits for goes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any

from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import JobRecord
from revisit.service.domain.states import OperationKind, OperationState
from revisit.service.features.operations.calls import Operations
from revisit.service.features.resources.call_context import CallContext
from revisit.service.ports.transactions import UnitOfWork

Result = dict[str, Any]


class WorkerAnswers:
    """Asks the workers."""

    def __init__(self, context: CallContext, operations: Operations) -> None:
        """Questions are jobs; `operations` waits for their results."""
        self._context = context
        self._operations = operations

    async def answer(
        self,
        tenant: TenantId,
        kind: OperationKind,
        subject: str,
        payload: dict[str, Any],
        timeout_s: float,
        discard: Callable[[Result], None] = lambda _result: None,
    ) -> Result:
        """The result of a job. Raises the worker's error, NoAnswer, WorkersBusy.

        A job that nobody waits for any more is dropped. One that has ended by then stays, and `discard`, which may
        block, is given its result, as nobody else is.
        """
        job = self._context.jobs.made(tenant, kind, subject, payload)
        operation: JobRecord | None = None
        try:
            await self._context.storage.write(partial(self._context.jobs.enqueue, job=job))
            operation = await self._operations.wait(tenant, job.operation_id, timeout_s)
        finally:
            # A caller that leaves meanwhile does not undo the job: it is queued before this, or never.
            if operation is None or not operation.done:
                await asyncio.shield(self._release(job, discard))
        return self._operations.require_result(
            operation, f"no worker answered within {timeout_s:g} s, and the query was dropped"
        )

    async def _release(self, job: JobRecord, discard: Callable[[Result], None]) -> None:
        unread = await self._context.storage.write(partial(_drop, asked=job))
        if unread is not None:
            await asyncio.to_thread(discard, unread)


def _drop(uow: UnitOfWork, asked: JobRecord) -> Result | None:
    """Forget a job that has not ended: a worker that runs it finds its lease gone, and its result is refused.

    The result of one that has.
    """
    job = uow.jobs.get(asked.tenant, asked.operation_id, hold=True)
    if job is None:
        return None
    if job.state in (OperationState.QUEUED.value, OperationState.RUNNING.value):
        uow.jobs.delete(job.tenant, operation_id=job.operation_id)
    return job.result
