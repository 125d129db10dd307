"""A service without processes: use cases over chosen stores, and workers that run a job when told to."""

from __future__ import annotations

import asyncio
import threading
import weakref
from collections.abc import Awaitable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import PipelineConfig
from revisit.formats import DecodedCloud
from revisit.service.adapters.core_map_optimiser import CoreMapOptimiser
from revisit.service.context import ServiceContext
from revisit.service.domain.identity import DEFAULT_TENANT, SessionKey, SubmapKey
from revisit.service.domain.policy import Policy
from revisit.service.engines.local.files.blobs import FileBlobStore
from revisit.service.engines.local.sqlite.transactions import SqliteTransactions
from revisit.service.engines.postgres.transactions import PostgresTransactions
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.ingest.calls import AppendScan
from revisit.service.features.ingest.posting import PostSubmap
from revisit.service.features.operations.job_runner import JobRunner
from revisit.service.ports.blobs import BlobOutage, BlobStore
from revisit.service.ports.disk import DiskSpace, UnlimitedDisk
from revisit.service.ports.map_merger import MapMerger
from revisit.service.ports.map_optimiser import MapOptimiser
from revisit.service.ports.map_tiles import TileMaker
from revisit.service.ports.recogniser import PlaceRecogniser
from revisit.service.use_cases import UseCases
from tests.support.fake_merger import FakeMerger
from tests.support.fake_recogniser import FakeRecogniser
from tests.support.fake_tiler import FakeTiler
from tests.support.made_database import made_database
from tests.support.memory.blobs import MemoryBlobStore
from tests.support.memory.transactions import MemoryTransactions
from tests.support.memory.vector_index import MemoryVectorIndex
from tests.support.state import ON_POSTGRES, database_of
from tests.support.stepped_clock import SteppedClock

T = TypeVar("T")

TENANT = DEFAULT_TENANT
SESSION = SessionKey("town", "monday")


@dataclass
class World:
    """The service and the hands of a worker."""

    context: ServiceContext
    use_cases: UseCases
    clock: SteppedClock
    optimiser: MapOptimiser = field(default_factory=CoreMapOptimiser)
    merger: MapMerger = field(default_factory=FakeMerger)
    tiler: TileMaker = field(default_factory=FakeTiler)
    home: Path | None = None

    def another_gateway(self) -> World:
        """The world with a second gateway in place of this one, over the same store."""
        here = self.context
        own = ServiceContext(here.transactions, here.blobs, MemoryVectorIndex(), here.clock, here.policy)
        return replace(self, context=own, use_cases=UseCases.over(own, "test"))

    def worker(self, recogniser: PlaceRecogniser | None = None) -> JobRunner:
        """Another worker's jobs, with an index of its own."""
        own = replace(self.context, index=MemoryVectorIndex())
        return own.jobs(recogniser or FakeRecogniser(), self.optimiser, self.merger, self.tiler)

    def claim(self, owner: str = "w1"):
        """The next lease, or None."""
        return self.context.transactions.write(lambda uow: uow.queue.claim(owner)).result()

    def work_off(self, recogniser: PlaceRecogniser | None = None) -> int:
        """Run every job that is due; how many."""
        worker, done = self.worker(recogniser), 0
        while (lease := self.claim()) is not None:
            worker.run(lease)
            done += 1
        return done


async def answered(world: World, question: Awaitable[T], recogniser: PlaceRecogniser | None = None) -> T:
    """The answer to a question for which workers must do something."""
    asked = asyncio.ensure_future(question)
    while not asked.done():
        await asyncio.to_thread(world.work_off, recogniser)
        await asyncio.sleep(0.005)
    return await asked


def policy(pipeline: PipelineConfig = PipelineConfig(), **overrides) -> Policy:
    """Submaps of 10 m every 5 m; places lie a metre apart, half a metre from one it is left."""
    loop = replace(pipeline.loop, leave_distance=0.5)
    return Policy(pipeline=replace(pipeline, loop=loop), **overrides)


def memory_world(clock: SteppedClock | None = None, blobs: BlobStore | None = None, **overrides) -> World:
    """The service over the stores in memory, or other `blobs`; over PostgreSQL where REVISIT_TEST_STATE asks for it."""
    rules, clock, blobs = policy(**overrides), clock or SteppedClock(), blobs or MemoryBlobStore()
    if ON_POSTGRES:
        transactions = postgres_transactions(rules, clock)
        world = _world(transactions, blobs, rules, clock)
        weakref.finalize(world.context.storage, transactions.close)
        return world
    return _world(MemoryTransactions(rules.lease_ms, clock), blobs, rules, clock)


def sqlite_world(
    home: Path,
    disk: DiskSpace = UnlimitedDisk(),
    clock: SteppedClock | None = None,
    blobs: BlobStore | None = None,
    **overrides,
) -> World:
    """The service over SQLite and files in `home`, or other `blobs`; close its transactions at the end."""
    rules, clock = policy(**overrides), clock or SteppedClock()
    if ON_POSTGRES:
        transactions = postgres_transactions(rules, clock, home)
    else:
        database = made_database(home / "revisit.db")
        transactions = SqliteTransactions(database, checkpoints=True, lease_ms=rules.lease_ms, clock=clock)
    return replace(_world(transactions, blobs or FileBlobStore(home / "blobs"), rules, clock, disk), home=home)


def postgres_world(clock: SteppedClock | None = None, **overrides) -> World:
    """The service over PostgreSQL and blobs in memory; close its transactions at the end."""
    rules, clock = policy(**overrides), clock or SteppedClock()
    return _world(postgres_transactions(rules, clock), MemoryBlobStore(), rules, clock)


def postgres_transactions(rules: Policy, clock: SteppedClock, home: Path | None = None) -> PostgresTransactions:
    """A new database on the server of this test process, or that of a `home`."""
    from tests.support.postgres import shared_server

    url = shared_server().made_database() if home is None else database_of(home)
    return PostgresTransactions(url, lease_ms=rules.lease_ms, clock=clock, now_ms=lambda _: clock.ms)


def _world(transactions, blobs, rules: Policy, clock: SteppedClock, disk: DiskSpace = UnlimitedDisk()) -> World:
    context = ServiceContext(transactions, blobs, MemoryVectorIndex(), clock, rules, threading.Event(), disk=disk)
    if isinstance(blobs, BlobOutage):
        context = replace(context, blob_outage=blobs)
    return World(context, UseCases.over(context, "test"), clock)


async def open_session(world: World, session: SessionKey = SESSION, tenant=TENANT) -> None:
    """Create the map and the session."""
    await world.use_cases.maps.create(tenant, CreateMap(session.map_id))
    await world.use_cases.sessions.create(tenant, CreateSession(session.map_id, session.session_id))


async def posted(world: World, session: SessionKey = SESSION, tenant=TENANT, **places: int) -> None:
    """Create the map and the session, and post these submaps of these places, which wait for a worker."""
    await open_session(world, session, tenant)
    for submap_id, place in places.items():
        await world.use_cases.posting.post(tenant, submap(submap_id, place, session))


async def described(world: World, **places: int) -> None:
    """As `posted`; the jobs are done."""
    await posted(world, **places)
    world.work_off()


def described_home(home: Path, submaps: int) -> Path:
    """`home` with the data of a service that has so many submaps, each of a place of its own; nothing has it open."""
    world = sqlite_world(home)
    asyncio.run(described(world, **{f"s{number}": number for number in range(submaps)}))
    world.context.transactions.close()
    return home


def cloud(place: int, points: int = 300) -> DecodedCloud:
    """A cloud of `place`: clouds of the same place match under the fake recogniser, others do not."""
    return DecodedCloud(cloud_points(place, points))


def cloud_points(place: int, points: int = 300) -> NDArray[np.float32]:
    """The points (n, 3): heights in a band of their own for every place."""
    rng = np.random.default_rng(place)
    xy = rng.uniform(-20.0, 20.0, (points, 2))
    z = rng.uniform(-7.9, 7.9, 2)[np.arange(points) % 2] + rng.uniform(0.0, 0.05, points)
    return np.column_stack([xy, z]).astype(np.float32)


def pose(x_m: float = 0.0) -> NDArray[np.float64]:
    """T_odom_sensor at (x_m, 0, 0), unrotated."""
    T_odom_sensor = np.eye(4)
    T_odom_sensor[0, 3] = x_m
    return T_odom_sensor


def submap(submap_id: str, place: int, session: SessionKey = SESSION, points: int = 300) -> PostSubmap:
    """A posted submap of `place`."""
    key = SubmapKey(session.map_id, session.session_id, submap_id)
    return PostSubmap(key, pose(float(place)), 1_000 + place, cloud(place, points))


def scan(seq: int, x_m: float, session: SessionKey = SESSION) -> AppendScan:
    """Scan `seq` taken at x_m."""
    return AppendScan(session, seq, seq * 100, pose(x_m), cloud(seq))
