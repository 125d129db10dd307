"""What every use case is given: the ports, the policy, and whether new work is still taken."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import asynccontextmanager
from contextvars import copy_context
from dataclasses import dataclass, field, replace
from functools import partial
from typing import ParamSpec, TypeVar

from revisit.core.config import PipelineConfig
from revisit.service.application.capacity.intake import DECODERS, QUEUE_RETRY_S, Intake
from revisit.service.application.contract.errors import Draining, StorageFull, WorkersBusy
from revisit.service.application.contract.identity import TenantId
from revisit.service.application.contract.ports import (
    BlobStore,
    Clock,
    DiskSpace,
    Transactions,
    UnitOfWork,
    VectorIndex,
)
from revisit.service.application.contract.records import MapRecord
from revisit.service.application.ingest.stream_endings import StreamEndings

P = ParamSpec("P")
T = TypeVar("T")
N = TypeVar("N", int, float)


@dataclass(frozen=True)
class Policy:
    """The rules of this installation: the method's parameters and the bounds of its queue."""

    pipeline: PipelineConfig = field(default_factory=PipelineConfig)
    max_queued_jobs: int = 1000
    max_attempts: int = 3
    lease_ms: int = 10_000

    def for_map(self, record: MapRecord) -> PipelineConfig:
        """The method's parameters with what the map overrides."""
        submap, loop, verification = self.pipeline.submap, self.pipeline.loop, self.pipeline.verification
        return replace(
            self.pipeline,
            scene_scale=record.scene_scale,
            submap=replace(
                submap,
                min_range=submap.min_range * record.scene_scale,
                tau=_given(record.tau_m, submap.tau),
                stride=_given(record.stride_m, submap.stride),
            ),
            loop=replace(
                loop,
                min_index_gap=_given(record.min_index_gap, loop.min_index_gap),
                candidates=_given(record.loop_candidates, loop.candidates),
            ),
            verification=replace(
                verification,
                min_score=_given(record.min_score, verification.min_score),
                min_overlap=_given(record.min_overlap, verification.min_overlap),
                max_seen_through=_given(record.max_seen_through, verification.max_seen_through),
            ),
        )


def _given(own: N | None, of_service: N) -> N:
    return of_service if own is None else own


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
    stream_endings: StreamEndings = field(default_factory=StreamEndings)
    decoders: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(DECODERS, "decode"))

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

    async def decode(self, work: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """As `compute`, for clouds, which take a core each: the others wait for their turn."""
        here = partial(copy_context().run, work, *args, **kwargs)
        return await asyncio.get_running_loop().run_in_executor(self.decoders, here)

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
        """A place for one cloud, which becomes a job if it is `queued`.

        Call what is given with the cloud's points once it is decoded. Raises RateLimited; WorkersBusy where the queue
        is full, or there is no place, unless `patient`.
        """
        self.intake.require_points(tenant)
        if queued:
            await self.require_room(tenant)
        async with self.intake.cloud(tenant, patient=patient) as decoded:
            yield decoded

    async def require_room(self, tenant: TenantId) -> None:
        """As `require_queue_space`, before any work is done: with the jobs that what is being taken in will become."""
        most = self.policy.max_queued_jobs
        if self.intake.queue_seems_full(tenant, most) and not self.intake.recounted_lately(tenant):
            self.intake.note_recount(tenant, await self.read(lambda uow: _waiting(uow, tenant)))
        if self.intake.queue_seems_full(tenant, most):
            self.intake.note_crowd(tenant)
            raise _queue_is_full(most)

    def require_queue_space(self, uow: UnitOfWork, tenant: TenantId) -> None:
        """Raises WorkersBusy where the tenant has too many jobs waiting, else counts on one more."""
        waiting, most = _waiting(uow, tenant), self.policy.max_queued_jobs
        self.intake.expect_waiting(tenant, min(waiting + 1, most))
        if waiting >= most:
            raise _queue_is_full(most)


def _waiting(uow: UnitOfWork, tenant: TenantId) -> int:
    return uow.jobs.count(tenant, state="QUEUED")


def _queue_is_full(most: int) -> WorkersBusy:
    return WorkersBusy(f"{most} jobs are waiting; try again later with the same id", retry_after_s=QUEUE_RETRY_S)


async def _outcome(future: Future[T]) -> T:
    return await asyncio.shield(asyncio.wrap_future(future))
