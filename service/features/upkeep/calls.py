"""The service itself: readiness, status, drain."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from revisit.api.words import NO_WORKER
from revisit.core.errors import RevisitError
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import WorkerRecord
from revisit.service.domain.states import OperationState, SubmapState
from revisit.service.features.index.keeping import IndexHealth
from revisit.service.features.resources.call_context import CallContext
from revisit.service.ports.blobs import BlobOutage
from revisit.service.ports.disk import DiskSpace
from revisit.service.ports.transactions import UnitOfWork

WORKER_SEEN_WITHIN_MS = 15_000

LOG_ALARM_BYTES = 64 * 2**20
"""A log that grows beyond is not folded back any more: some reader keeps a snapshot for very long."""


@dataclass(frozen=True)
class Readiness:
    """Whether requests can be served; `reasons` says why not, `degraded` names refusals and faults beside that."""

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
    """The service's work for a tenant. `model_version` is that of the newest worker, None before any started.

    `grpc_address`: where clients reach gRPC, :PORT on the host by which they reach HTTP; "" where nothing listens.
    """

    version: str
    model_version: str | None
    queued_jobs: int
    running_jobs: int
    failed_jobs: int
    indexed_submaps: int
    workers: tuple[WorkerView, ...]
    grpc_address: str


class System:
    """Readiness, status, drain."""

    def __init__(
        self, context: CallContext, disk: DiskSpace, blobs: BlobOutage, index: IndexHealth, version: str
    ) -> None:
        """`index` is the state of this process's index; `version` is the product's."""
        self._context = context
        self._disk = disk
        self._blobs = blobs
        self._index = index
        self._version = version
        self._checking: asyncio.Task[Readiness] | None = None
        self._grpc_address = ""

    def reached_at(self, grpc_address: str) -> None:
        """From now on clients reach gRPC there (see `ServiceStatus`)."""
        self._grpc_address = grpc_address

    async def readiness(self) -> Readiness:
        """Ready when the database answers, the index is loaded and the service is not draining.

        Concurrent probes share one read of the database.
        """
        if self.draining:
            return Readiness(False, ("draining",))
        if self._index.loading:
            return Readiness(False, ("the index is being loaded",))
        if self._checking is None or self._checking.done():
            self._checking = asyncio.create_task(self._checked())
        return await asyncio.shield(self._checking)

    async def _checked(self) -> Readiness:
        try:
            workers = await self._context.storage.read(self._alive)
        except RevisitError as error:
            return Readiness(False, (f"database: {error.message}",))
        return Readiness(True, (), tuple(self._degraded(len(workers))))

    def _degraded(self, workers: int) -> Iterator[str]:
        if not workers:
            yield NO_WORKER
        if self._disk.full():
            yield "storage full: no new scans or submaps until there is room"
        if self._blobs.unreachable():
            yield "the store of blobs does not answer: no new scans or submaps, no downloads, and no job is begun"
        log_bytes = self._disk.log_bytes()
        if log_bytes > LOG_ALARM_BYTES:
            yield f"the log of the database has grown to {log_bytes >> 20} MiB: searches and starts become slower"

    async def status(self, tenant: TenantId) -> ServiceStatus:
        """Queue depth, index size, workers and model version."""
        return await self._context.storage.read(partial(self._status, tenant=tenant))

    def _status(self, uow: UnitOfWork, tenant: TenantId) -> ServiceStatus:
        alive = self._alive(uow)
        return ServiceStatus(
            version=self._version,
            model_version=alive[0].model_version if alive else None,
            queued_jobs=uow.jobs.count(tenant, state=OperationState.QUEUED.value),
            running_jobs=uow.jobs.count(tenant, state=OperationState.RUNNING.value),
            failed_jobs=uow.jobs.count(tenant, state=OperationState.FAILED.value),
            indexed_submaps=uow.submaps.count(tenant, state=SubmapState.DESCRIBED.value),
            workers=tuple(WorkerView(worker.worker_id, worker.model_version) for worker in alive),
            grpc_address=self._grpc_address,
        )

    def _alive(self, uow: UnitOfWork) -> Sequence[WorkerRecord]:
        return uow.workers.alive(WORKER_SEEN_WITHIN_MS)

    def drain(self) -> None:
        """From now on refuse new work with Draining; work in progress ends."""
        self._context.admission.stop()

    @property
    def draining(self) -> bool:
        """Whether `drain` was called."""
        return self._context.admission.stopping
