"""The service itself: is it alive, can it serve, what is it doing, is it stopping?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from service.application.identity import TenantId


@dataclass(frozen=True)
class Readiness:
    """Whether requests can be served; `reasons` says why not."""

    ready: bool
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class WorkerView:
    """A worker process that has shown itself within the last lease."""

    worker_id: str
    model_version: str


@dataclass(frozen=True)
class ServiceStatus:
    """What the service is doing for a tenant. `model_version` is that of the newest worker, None before any started."""

    version: str
    model_version: str | None
    queued_jobs: int
    running_jobs: int
    failed_jobs: int
    indexed_submaps: int
    workers: tuple[WorkerView, ...]


class System(Protocol):
    """Health, readiness, status, drain."""

    async def readiness(self) -> Readiness:
        """Ready when the database answers and the service is not draining."""
        ...

    async def status(self, tenant: TenantId) -> ServiceStatus:
        """Queue depth, index size, workers and model version."""
        ...

    def drain(self) -> None:
        """From now on refuse new work with Draining; what is under way ends."""
        ...

    @property
    def draining(self) -> bool:
        """Whether `drain` was called."""
        ...
