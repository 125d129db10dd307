"""One process of a service on PostgreSQL, as its database sees it: acknowledgements, or jobs claimed and completed."""

from __future__ import annotations

import threading
import time
import uuid
from dataclasses import replace
from functools import partial

from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import JobRecord, MapRecord, ScanRecord, SessionRecord
from revisit.service.engines.local.clock import SystemClock
from revisit.service.engines.postgres.connections import server_url
from revisit.service.engines.postgres.transactions import PostgresTransactions
from revisit.service.ports.transactions import UnitOfWork

POSE = (1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
MAPS = 50
SCANS_A_JOB = 5
"""Scans of which one completes a window: its transaction also queues a job, which is an event of its map."""

TENANTS = tuple(TenantId(f"fleet-{number}") for number in range(3))


def acknowledge(url: str, gateway: int, robots: int, seconds: float) -> int:
    """Commit scans of so many robots at once, each the next one when the last is committed; how many."""
    store = _opened(url)
    names = [f"{gateway}-{uuid.uuid4().hex}" for _ in range(robots)]
    for robot, name in enumerate(names):
        store.write(partial(_make_session, map_id=f"map-{robot % MAPS}", name=name)).result()
    return _until_over(
        store, [partial(_drive, store, f"map-{n % MAPS}", name) for n, name in enumerate(names)], seconds
    )


def work_off(url: str, host: int, clients: int, seconds: float) -> int:
    """Claim and complete jobs, so many clients with connections of their own; how many were completed."""
    stores = [_opened(url) for _ in range(clients)]
    runs = [partial(_work, store, f"worker-{host}-{number}") for number, store in enumerate(stores)]
    return _until_over(stores[0], runs, seconds, *stores[1:])


def queue_jobs(url: str, jobs: int) -> None:
    """Queue so many jobs of three tenants."""
    store = _opened(url)
    for start in range(0, jobs, 500):
        store.write(partial(_queue_some, count=500, first=start)).result()
    store.close()


def _opened(url: str) -> PostgresTransactions:
    return PostgresTransactions(server_url(url), clock=SystemClock(), lease_ms=60_000)


def _until_over(
    store: PostgresTransactions, runs: list[partial[None]], seconds: float, *more: PostgresTransactions
) -> int:
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
    for opened in (store, *more):
        opened.close()
    return sum(done)


def _make_session(uow: UnitOfWork, map_id: str, name: str) -> None:
    tenant = TENANTS[0]
    if uow.maps.get(tenant, map_id) is None:
        uow.maps.add(MapRecord(tenant, map_id, "hash", map_id, None, 5.0, None, None, 1))
    uow.sessions.add(SessionRecord(tenant, map_id, name, "hash", None, "ACTIVE", 0, 0, 0.0, 0.0, 1, None, 1, None))


def _drive(store: PostgresTransactions, map_id: str, name: str) -> None:
    store.write(partial(_append, map_id=map_id, name=name)).result()


def _append(uow: UnitOfWork, map_id: str, name: str) -> None:
    session = uow.sessions.get(TENANTS[0], map_id, name, hold=True)
    assert session is not None
    seq = session.committed_seq + 1
    uow.scans.get(session.tenant, map_id, name, session.committed_seq)
    uow.scans.add(ScanRecord(session.tenant, map_id, name, seq, seq, POSE, float(seq), 300, "c" * 64))
    uow.sessions.replace(replace(session, committed_seq=seq))
    if seq % SCANS_A_JOB == 0:
        uow.queue.enqueue(_job(session.tenant, f"maps/{map_id}"))


def _work(store: PostgresTransactions, owner: str) -> None:
    lease = store.write(lambda uow: uow.queue.claim(owner), durable=False).result()
    if lease is not None:
        store.write(lambda uow: uow.queue.complete(lease, {})).result()


def _queue_some(uow: UnitOfWork, count: int, first: int) -> None:
    for number in range(first, first + count):
        uow.queue.enqueue(_job(TENANTS[number % len(TENANTS)], f"maps/map-{number % MAPS}"))


def _job(tenant: TenantId, subject: str) -> JobRecord:
    return JobRecord(tenant, uuid.uuid4().hex, "DESCRIBE_SUBMAP", "QUEUED", subject, {}, 0, 3, 1)
