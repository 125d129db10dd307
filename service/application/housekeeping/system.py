"""The service itself: whether it can serve, what it is doing, whether it is stopping."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from revisit.core.errors import RevisitError
from revisit.service.application.contract.context import Context
from revisit.service.application.contract.identity import TenantId
from revisit.service.application.contract.ports import UnitOfWork

WORKER_SEEN_WITHIN_MS = 15_000

WAL_ALARM_BYTES = 64 * 2**20
"""A log that grows beyond is not folded back any more: some reader keeps a snapshot for very long."""


@dataclass(frozen=True)
class Readiness:
    """Whether requests can be served; `reasons` says why not, `degraded` what is refused, or wrong, nevertheless."""

    ready: bool
    reasons: tuple[str, ...]
    degraded: tuple[str, ...] = ()


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


class System:
    """Readiness, status, drain."""

    def __init__(self, context: Context, version: str) -> None:
        """`version` is the product's."""
        self._context = context
        self._version = version

    async def readiness(self) -> Readiness:
        """Ready when the database answers, the index is loaded and the service is not draining."""
        if self.draining:
            return Readiness(False, ("draining",))
        if self._context.index_health.loading:
            return Readiness(False, ("the index is being loaded",))
        try:
            await self._context.read(lambda uow: uow.workers.alive("", 0))
        except RevisitError as error:
            return Readiness(False, (f"database: {error.message}",))
        return Readiness(True, (), tuple(self._degraded()))

    def _degraded(self) -> Iterator[str]:
        if self._context.disk.full():
            yield "storage full: no new scans or submaps until there is room"
        wal_bytes = self._context.disk.wal_bytes()
        if wal_bytes > WAL_ALARM_BYTES:
            yield f"the log of the database has grown to {wal_bytes >> 20} MiB: searches and starts become slower"

    async def status(self, tenant: TenantId) -> ServiceStatus:
        """Queue depth, index size, workers and model version."""
        now = self._context.clock.instant()

        def load(uow: UnitOfWork) -> ServiceStatus:
            alive = uow.workers.alive(now.epoch, now.ms - WORKER_SEEN_WITHIN_MS)
            return ServiceStatus(
                version=self._version,
                model_version=alive[0].model_version if alive else None,
                queued_jobs=uow.jobs.count(tenant, state="QUEUED"),
                running_jobs=uow.jobs.count(tenant, state="RUNNING"),
                failed_jobs=uow.jobs.count(tenant, state="FAILED"),
                indexed_submaps=uow.submaps.count(tenant, state="DESCRIBED"),
                workers=tuple(WorkerView(worker.worker_id, worker.model_version) for worker in alive),
            )

        return await self._context.read(load)

    def admit_cloud(self, tenant: TenantId) -> None:
        """What can be said before a cloud is read. Raises Draining, RateLimited, WorkersBusy."""
        self._context.admit()
        self._context.intake.require_points(tenant)
        self._context.intake.require_place(tenant)

    async def admit_job(self, tenant: TenantId) -> None:
        """As `admit_cloud`, for a cloud that becomes a job. Raises also WorkersBusy where the queue is full."""
        self.admit_cloud(tenant)
        await self._context.require_room(tenant)

    def drain(self) -> None:
        """From now on refuse new work with Draining; what is under way ends."""
        self._context.stopping.set()

    @property
    def draining(self) -> bool:
        """Whether `drain` was called."""
        return self._context.stopping.is_set()
