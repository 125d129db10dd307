"""Jobs that several callers ask for: queued once, waited for together, and kept when a caller leaves."""

from __future__ import annotations

from functools import partial
from typing import Any

from revisit.service.capacity.backlog import UNENDED, same_job
from revisit.service.domain import limits
from revisit.service.domain.errors import AlreadyExists
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import JobRecord
from revisit.service.domain.states import OperationKind
from revisit.service.features.operations.calls import Operations
from revisit.service.features.resources.call_context import CallContext
from revisit.service.ports.transactions import UnitOfWork

_LONG = (OperationKind.MEASURE_MAP,)
"""Kinds of jobs with payloads of many points, of which there are many with one subject."""


class JoinedJobs:
    """Asks the workers for what they keep."""

    def __init__(self, context: CallContext, operations: Operations) -> None:
        """`operations` waits for results."""
        self._context = context
        self._operations = operations

    async def answer(
        self, tenant: TenantId, kind: OperationKind, subject: str, payload: dict[str, Any]
    ) -> dict[str, Any]:
        """Queue a job, or join the same one, and wait for it. Raises the worker's error, NoAnswer, WorkersBusy."""
        self._context.admission.require_storage()
        post = partial(self._posted, tenant=tenant, kind=kind, subject=subject, payload=payload)
        try:
            job = await self._context.storage.write(post)
        except AlreadyExists:  # another gateway was first
            job = await self._context.storage.write(post)
        operation = await self._operations.wait(tenant, job.operation_id, limits.TILE_WAIT_S)
        return self._operations.require_result(
            operation, f"no worker answered within {limits.TILE_WAIT_S:g} s; ask again"
        )

    def _posted(
        self, uow: UnitOfWork, tenant: TenantId, kind: OperationKind, subject: str, payload: dict[str, Any]
    ) -> JobRecord:
        if kind in _LONG:
            return self._context.jobs.ask(uow, tenant, kind, subject, payload)[0]
        under_way = same_job(uow, tenant, kind, subject, payload, UNENDED)
        return under_way or self._context.jobs.post(uow, tenant, kind, subject, payload)
