"""Operations: work that goes on after the answer; the client's view of a job."""

from __future__ import annotations

import asyncio
import secrets
import time
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from revisit.service.application.catalogue.paging import Page, PageRequest, page_of
from revisit.service.application.contract import limits
from revisit.service.application.contract.context import Context
from revisit.service.application.contract.errors import NotFound
from revisit.service.application.contract.identity import TenantId
from revisit.service.application.contract.origin import current_origin
from revisit.service.application.contract.ports import UnitOfWork
from revisit.service.application.contract.records import JobRecord

SUBMAP_DELETED = {"outcome": "the submap was deleted"}
"""The result of a job whose submap is gone."""

_POLL_S = (0.02, 0.25)


class OperationKind(StrEnum):
    """What a job does."""

    DESCRIBE_SUBMAP = "DESCRIBE_SUBMAP"
    SEARCH_CLOUD = "SEARCH_CLOUD"
    LOCALIZE = "LOCALIZE"


class OperationState(StrEnum):
    """Where a job stands."""

    QUEUED = "QUEUED"
    RUNNING = "RUNNING"
    DONE = "DONE"
    FAILED = "FAILED"


@dataclass(frozen=True)
class OperationFailure:
    """Why an operation failed: an ErrorCode and a sentence."""

    code: str
    message: str


@dataclass(frozen=True)
class OperationView:
    """An operation as clients see it. `subject` is a resource name (a submap or a map); `result` is JSON, once DONE."""

    operation_id: str
    kind: OperationKind
    state: OperationState
    subject: str
    attempts: int
    result: dict[str, Any] | None
    failure: OperationFailure | None
    created_at_ns: int
    finished_at_ns: int | None

    @property
    def done(self) -> bool:
        """Whether it has ended, well or not."""
        return self.state in (OperationState.DONE, OperationState.FAILED)


class Operations:
    """Get, list and wait for operations."""

    def __init__(self, context: Context) -> None:
        """All calls use `context`."""
        self._context = context

    async def get(self, tenant: TenantId, operation_id: str) -> OperationView:
        """Raises NotFound."""

        def load(uow: UnitOfWork) -> OperationView:
            record = uow.jobs.get(tenant, operation_id)
            if record is None:
                raise NotFound(f"there is no operation {operation_id!r}"[:200])
            return operation_view(record)

        return await self._context.read(load)

    async def list(
        self, tenant: TenantId, page: PageRequest, state: OperationState | None = None
    ) -> Page[OperationView]:
        """The tenant's operations, oldest first."""
        only: dict[str, str] = {} if state is None else {"state": state.value}
        records = await self._context.read(
            lambda uow: uow.jobs.find(tenant, after=page.after, limit=page.size + 1, **only)
        )
        return page_of(records, page, operation_view)

    async def wait(self, tenant: TenantId, operation_id: str, timeout_s: float) -> OperationView:
        """The operation once it has ended, or as it stands after `timeout_s` (at most 60). Raises NotFound.

        Returns early, as it stands, when the service stops.
        """
        deadline = time.monotonic() + min(max(timeout_s, 0.0), limits.WAIT_S.most)
        pause = _POLL_S[0]
        while True:
            operation = await self.get(tenant, operation_id)
            left = deadline - time.monotonic()
            if operation.done or left <= 0 or self._context.stopping.is_set():
                return operation
            await asyncio.sleep(min(pause, left))
            pause = min(pause * 1.5, _POLL_S[1])


def new_job(
    context: Context, tenant: TenantId, kind: OperationKind, subject: str, payload: dict[str, Any]
) -> JobRecord:
    """A job to queue, with an operation id of its own. Searches, for which a client waits, go before descriptions."""
    origin = current_origin()
    return JobRecord(
        tenant=tenant,
        operation_id=f"op-{secrets.token_hex(10)}",
        kind=kind.value,
        state=OperationState.QUEUED.value,
        subject=subject,
        payload=payload,
        attempts=0,
        max_attempts=context.policy.max_attempts,
        created_at_ns=context.clock.wall_ns(),
        priority=1 if kind is OperationKind.DESCRIBE_SUBMAP else 0,
        request_id=origin.request_id,
        traceparent=origin.span.traceparent,
    )


def operation_view(record: JobRecord) -> OperationView:
    """The client's view of a job."""
    return OperationView(
        operation_id=record.operation_id,
        kind=OperationKind(record.kind),
        state=OperationState(record.state),
        subject=record.subject,
        attempts=record.attempts,
        result=record.result,
        failure=failure_of(record.failure_code, record.failure_message),
        created_at_ns=record.created_at_ns,
        finished_at_ns=record.finished_at_ns,
    )


def failure_of(code: str | None, message: str | None) -> OperationFailure | None:
    """The failure that a row holds, if any."""
    return None if code is None else OperationFailure(code, message or "")
