"""Questions that workers answer: a job is posted, its result is waited for, and a job that nobody waits for goes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any

from revisit.service.capacity.admission import Admission
from revisit.service.capacity.backlog import JobPosting
from revisit.service.domain.errors import NoAnswer, error_of
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import JobRecord
from revisit.service.domain.states import OperationKind, OperationState
from revisit.service.features.operations.calls import Operations
from revisit.service.features.resources.views import OperationView
from revisit.service.ports.storage import Storage
from revisit.service.ports.transactions import UnitOfWork

Result = dict[str, Any]


class WorkerAnswers:
    """Asks the workers."""

    def __init__(self, storage: Storage, admission: Admission, jobs: JobPosting, operations: Operations) -> None:
        """Questions are jobs posted through `jobs`; `operations` waits for their results."""
        self._storage = storage
        self._admission = admission
        self._jobs = jobs
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
        posted: list[JobRecord] = []
        operation: OperationView | None = None
        try:
            post = partial(self._jobs.post, tenant=tenant, kind=kind, subject=subject, payload=payload)
            # Noted by the writer: a caller that leaves meanwhile does not undo the job.
            job = await self._storage.write(lambda uow: _noted(post(uow), posted))
            operation = await self._operations.wait(tenant, job.operation_id, timeout_s)
        finally:
            if operation is None or not operation.done:
                await asyncio.shield(self._release(posted, discard))
        if operation.failure is not None:
            raise error_of(operation.failure.code, operation.failure.message)
        if operation.result is None:
            self._admission.require_running()
            raise NoAnswer(f"no worker answered within {timeout_s:g} s, and the query was dropped")
        return operation.result

    async def _release(self, posted: list[JobRecord], discard: Callable[[Result], None]) -> None:
        unread = await self._storage.write(partial(_drop, left=posted))
        for result in unread:
            await asyncio.to_thread(discard, result)


def _noted(job: JobRecord, posted: list[JobRecord]) -> JobRecord:
    posted.append(job)
    return job


def _drop(uow: UnitOfWork, left: list[JobRecord]) -> list[Result]:
    """Forget the jobs that have not ended: a worker that runs one finds its lease gone, and its result is refused.

    The results of those that have. Runs behind the write that posted them, so `left` holds a job also where its caller
    left before that write.
    """
    stored = [uow.jobs.get(job.tenant, job.operation_id) for job in left]
    present = [job for job in stored if job is not None]
    for job in present:
        if job.state in (OperationState.QUEUED.value, OperationState.RUNNING.value):
            uow.jobs.delete(job.tenant, operation_id=job.operation_id)
    return [job.result for job in present if job.result is not None]
