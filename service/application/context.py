"""What every use case is given: the ports, the policy, and whether new work is still taken."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Future
from contextlib import asynccontextmanager
from contextvars import copy_context
from dataclasses import dataclass, field, replace
from typing import ParamSpec, TypeVar

from core.config import PipelineConfig
from service.application.errors import Draining, StorageFull, WorkersBusy
from service.application.identity import TenantId
from service.application.intake import QUEUE_RETRY_S, Intake
from service.application.ports import BlobStore, Clock, DiskSpace, Transactions, UnitOfWork, VectorIndex
from service.application.records import MapRecord

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class Policy:
    """The rules of this installation: the method's parameters and the bounds of its queue."""

    pipeline: PipelineConfig = field(default_factory=PipelineConfig)
    max_queued_jobs: int = 1000
    max_attempts: int = 3
    lease_ms: int = 10_000

    def for_map(self, record: MapRecord) -> PipelineConfig:
        """The method's parameters with what the map overrides."""
        submap, loop = self.pipeline.submap, self.pipeline.loop
        return replace(
            self.pipeline,
            scene_scale=record.scene_scale,
            submap=replace(
                submap,
                min_range=submap.min_range * record.scene_scale,
                tau=submap.tau if record.tau_m is None else record.tau_m,
                stride=submap.stride if record.stride_m is None else record.stride_m,
            ),
            loop=replace(
                loop,
                min_index_gap=loop.min_index_gap if record.min_index_gap is None else record.min_index_gap,
            ),
        )


class EndlessDisk:
    """`ports.DiskSpace` where nobody counts."""

    def full(self) -> bool:
        """See `ports.DiskSpace`."""
        return False

    def exhausted(self) -> bool:
        """See `ports.DiskSpace`."""
        return False

    def wal_bytes(self) -> int:
        """See `ports.DiskSpace`."""
        return 0


@dataclass
class IndexHealth:
    """How this process's index stands to the database.

    `loading`: it is being loaded after a start, and the service is not ready. `drift`: how many submaps were found to
    differ, and mended, since.
    """

    loading: bool = False
    drift: int = 0


@dataclass(frozen=True)
class Context:
    """Ports and policy, and the ways from the event loop into threads."""

    transactions: Transactions
    blobs: BlobStore
    index: VectorIndex
    clock: Clock
    policy: Policy
    stopping: threading.Event = field(default_factory=threading.Event)
    intake: Intake = field(default_factory=Intake)
    disk: DiskSpace = field(default_factory=EndlessDisk)
    index_health: IndexHealth = field(default_factory=IndexHealth)

    async def write(self, work: Callable[[UnitOfWork], T], *, alone: bool = False) -> T:
        """Commit `work` (see `ports.Transactions`); a caller that is cancelled does not undo it."""
        # The writer has a thread of its own, to which the origin of the request must go along.
        here = copy_context()
        return await _outcome(self.transactions.write(lambda uow: here.run(work, uow), alone=alone))

    async def read(self, work: Callable[[UnitOfWork], T]) -> T:
        """Run `work` on a snapshot."""
        return await _outcome(self.transactions.read(work))

    async def compute(self, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run `work`, which may take milliseconds of CPU or disk, beside the event loop."""
        return await asyncio.to_thread(work, *args, **kwargs)

    def admit(self) -> None:
        """Raises Draining once the service is stopping."""
        if self.stopping.is_set():
            raise Draining

    def admit_data(self) -> None:
        """As `admit`, for what brings data with it. Raises also StorageFull while the disk is full."""
        self.admit()
        if self.disk.full():
            raise StorageFull

    @asynccontextmanager
    async def taking_in(
        self, tenant: TenantId, *, patient: bool = False, queued: bool = True
    ) -> AsyncIterator[Callable[[int], None]]:
        """A place for one cloud, which becomes a job if it is `queued`; call what is given with the number of points.

        Raises RateLimited; WorkersBusy where the queue was full a moment ago, or there is no place, unless `patient`.
        """
        self.intake.require_points(tenant)
        if queued:
            self.intake.require_queue(tenant)
        async with self.intake.cloud(tenant, patient=patient):
            yield lambda points: self.intake.spend(tenant, points)

    def require_queue_space(self, uow: UnitOfWork, tenant: TenantId) -> None:
        """Raises WorkersBusy where the tenant has too many jobs waiting."""
        waiting = uow.jobs.count(tenant, state="QUEUED")
        if waiting >= self.policy.max_queued_jobs:
            self.intake.note_full_queue(tenant)
            message = f"{waiting} jobs are waiting; try again later with the same id"
            raise WorkersBusy(message, retry_after_s=QUEUE_RETRY_S)


async def _outcome(future: Future[T]) -> T:
    return await asyncio.shield(asyncio.wrap_future(future))
