"""One process of a service on PostgreSQL, as its database sees it: acknowledgements, or jobs claimed and completed."""

from __future__ import annotations

import asyncio
import threading
import time
import uuid
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from sqlalchemy import Engine, event

from revisit.core.scan import CloudReport, Scan
from revisit.service.capacity.backlog import Backlog, JobPosting
from revisit.service.capacity.in_flight import InFlight
from revisit.service.domain.identity import SessionKey, TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import JobRecord, MapRecord, SessionRecord
from revisit.service.engines.local.clock import SystemClock
from revisit.service.engines.postgres.connections import server_url
from revisit.service.engines.postgres.transactions import PostgresTransactions
from revisit.service.features.ingest.appending import AcceptedScan, Appending, ScanStream
from revisit.service.features.operations.claiming import JobClaims
from revisit.service.ports.blobs import NoOutage
from revisit.service.ports.disk import UnlimitedDisk
from revisit.service.ports.storage import Storage, require_session
from revisit.service.ports.transactions import UnitOfWork

MAPS = 50
STEP_M = 1.0
"""Between two scans: of the default windows each fifth scan completes one, which is a submap, a job and an event."""

POINTS = np.zeros((1, 3), dtype=np.float32)
TENANTS = tuple(TenantId(f"fleet-{number}") for number in range(3))


@dataclass(frozen=True)
class Figures:
    """Calls that ended in time; CPU seconds of this process, and its statements, meanwhile."""

    calls: int
    cpu_s: float
    statements: int


def acknowledge(url: str, gateway: int, robots: int, seconds: float, *, together: bool = True) -> Figures:
    """Commit scans of so many robots at once, each the next one when the last is committed.

    `together`: as the service does it; else each scan is read for and written by itself.
    """
    store = _opened(url)
    storage, clock = Storage(store, None), SystemClock()  # type: ignore[arg-type]  # no blob is stored
    policy = Policy(max_queued_jobs=10**9)
    jobs = JobPosting(Backlog(storage, InFlight(), policy.max_queued_jobs), clock, policy)
    appending = Appending(storage, jobs, policy, clock)
    of_robots = [_begun(store, gateway, robot) for robot in range(robots)]
    append = appending.append if together else partial(_by_itself, appending, storage)
    figures = asyncio.run(_driven([_Robot(append, one) for one in of_robots], seconds))
    store.close()
    return figures


def work_off(url: str, host: int, clients: int, seconds: float) -> Figures:
    """Claim and complete jobs, so many clients with connections of their own."""
    stores = [_opened(url) for _ in range(clients)]
    runs = [partial(_work, store, f"worker-{host}-{number}") for number, store in enumerate(stores)]
    with _counted() as statements:
        began_s = time.process_time()
        calls = _until_over(runs, seconds)
        figures = Figures(calls, time.process_time() - began_s, statements[0])
    for store in stores:
        store.close()
    return figures


def queue_jobs(url: str, jobs: int) -> None:
    """Queue so many jobs of three tenants."""
    store = _opened(url)
    for start in range(0, jobs, 500):
        store.write(partial(_queue_some, count=500, first=start)).result()
    store.close()


def _opened(url: str) -> PostgresTransactions:
    return PostgresTransactions(server_url(url), clock=SystemClock(), lease_ms=60_000)


@contextmanager
def _counted() -> Iterator[list[int]]:
    """How many statements the block sends, commits among them."""
    count = [0]

    def note(*_: Any) -> None:
        count[0] += 1

    for moment in ("before_cursor_execute", "commit"):
        event.listen(Engine, moment, note)
    try:
        yield count
    finally:
        for moment in ("before_cursor_execute", "commit"):
            event.remove(Engine, moment, note)


async def _driven(robots: list[_Robot], seconds: float) -> Figures:
    """The figures of all but the first scans, with which a gateway learns where its sessions stand."""
    for _ in range(2):
        await asyncio.gather(*(robot.send() for robot in robots))
    with _counted() as statements:
        began_s = time.process_time()
        calls = await asyncio.gather(*(robot.drive(time.monotonic() + seconds) for robot in robots))
        return Figures(sum(calls), time.process_time() - began_s, statements[0])


class _Robot:
    """Sends each scan once the one before is committed."""

    def __init__(self, append: Callable[..., Awaitable[Any]], session: SessionRecord) -> None:
        self._append, self._session = append, session
        self._stream, self._seq = ScanStream.of(session.number), 0

    async def drive(self, until_s: float) -> int:
        """How many scans it has sent until then."""
        before = self._seq
        while time.monotonic() < until_s:
            await self.send()
        return self._seq - before

    async def send(self) -> None:
        """Send the next scan."""
        self._seq += 1
        T_odom_sensor = np.eye(4)
        T_odom_sensor[0, 3] = STEP_M * self._seq
        scan = Scan(POINTS, T_odom_sensor, self._seq, CloudReport(0, degenerate_plane=False))
        session, sha256 = self._session, uuid.uuid4().hex * 2
        key = SessionKey(session.map_id, session.session_id)
        accepted = AcceptedScan(session.tenant, key, session.number, self._stream, self._seq, scan, sha256)
        await self._append(accepted, put=lambda: None)
        self._stream = self._stream.begun()


async def _by_itself(appending: Appending, storage: Storage, accepted: AcceptedScan, put: Callable[[], object]) -> None:
    await storage.read(partial(require_session, tenant=accepted.tenant, key=accepted.session))
    await storage.write_naming(partial(appending.insert, accepted=accepted), put)


def _begun(store: PostgresTransactions, gateway: int, robot: int) -> SessionRecord:
    name = f"{gateway}-{uuid.uuid4().hex}"
    return store.write(partial(_make_session, map_id=f"map-{robot % MAPS}", name=name)).result()


def _make_session(uow: UnitOfWork, map_id: str, name: str) -> SessionRecord:
    tenant = TENANTS[0]
    if uow.maps.get(tenant, map_id) is None:
        uow.maps.add(MapRecord(tenant, map_id, "hash", map_id, None, None, None, None, 1))
    session = SessionRecord(tenant, map_id, name, "hash", None, "ACTIVE", 0, 0, 0.0, 0.0, 1, None, 1, None)
    return uow.sessions.add(session)


def _until_over(runs: list[partial[None]], seconds: float) -> int:
    """Call each of `runs` again and again, in a thread of its own, for so long; how many calls ended in time."""
    over, done = time.monotonic() + seconds, [0] * len(runs)

    def repeat(number: int) -> None:
        while time.monotonic() < over:
            runs[number]()
            done[number] += 1

    threads = [threading.Thread(target=repeat, args=(number,)) for number in range(len(runs))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sum(done)


def _work(store: PostgresTransactions, owner: str) -> None:
    lease = JobClaims(store, UnlimitedDisk(), NoOutage(), owner).next()
    if lease is not None:
        store.write(lambda uow: uow.queue.complete(lease, {})).result()


def _queue_some(uow: UnitOfWork, count: int, first: int) -> None:
    for number in range(first, first + count):
        uow.queue.enqueue(_job(TENANTS[number % len(TENANTS)], f"maps/map-{number % MAPS}"))


def _job(tenant: TenantId, subject: str) -> JobRecord:
    return JobRecord(tenant, uuid.uuid4().hex, "DESCRIBE_SUBMAP", "QUEUED", subject, {}, 0, 3, 1)
