"""Operations: work that goes on after the answer; the client's view of a job."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol

from service.application.identity import TenantId
from service.application.paging import Page, PageRequest


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


class Operations(Protocol):
    """Get, list and wait for operations."""

    async def get(self, tenant: TenantId, operation_id: str) -> OperationView:
        """Raises NotFound."""
        ...

    async def list(
        self, tenant: TenantId, page: PageRequest, state: OperationState | None = None
    ) -> Page[OperationView]:
        """The tenant's operations, oldest first."""
        ...

    async def wait(self, tenant: TenantId, operation_id: str, timeout_s: float) -> OperationView:
        """The operation once it has ended, or as it stands after `timeout_s` (at most 60). Raises NotFound."""
        ...
