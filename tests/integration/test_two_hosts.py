"""Two hosts share a store: its clock decides, whatever theirs say. Two boot ids stand for the hosts."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from functools import partial

import pytest
from sqlalchemy import text

from revisit.service.domain.errors import StaleLease
from revisit.service.engines.local.sqlite.transactions import SqliteTransactions
from revisit.service.engines.postgres.engine import FRESH_S
from revisit.service.engines.postgres.transactions import PostgresTransactions
from tests.support.made_database import made_database
from tests.support.patience import eventually
from tests.support.records import a_job
from tests.support.stepped_clock import SteppedClock

LEASE_MS = 10_000
HOUR_MS = 3_600_000
LEASES_END = "UPDATE jobs SET lease_expires_ms = lease_expires_ms - :ms"


@dataclass
class Host:
    """A host's hands on the store, and its clock."""

    transactions: SqliteTransactions | PostgresTransactions
    clock: SteppedClock
    name: str

    def write(self, work):
        return self.transactions.write(work).result()

    def claim(self):
        return self.write(lambda uow: uow.queue.claim(f"worker-{self.name}-1"))

    def beat(self):
        self.write(lambda uow: uow.workers.beat(f"worker-{self.name}-1", "m"))

    def alive(self):
        return self.transactions.read(lambda uow: [one.worker_id for one in uow.workers.alive(LEASE_MS)]).result()


@pytest.fixture(params=["sqlite", "postgres"])
def hosts(request, tmp_path):
    """Hosts a and b, whose monotonic clocks have nothing in common."""
    clocks = [SteppedClock("boot-a", 5_000_000), SteppedClock("boot-b", 40)]
    if request.param == "sqlite":
        database = made_database(tmp_path / "revisit.db")
        opened = [SqliteTransactions(database, checkpoints=first, clock=clocks[not first]) for first in (True, False)]
    else:
        url = request.getfixturevalue("postgres_url")
        opened = [PostgresTransactions(url, clock=clock) for clock in clocks]
    yield [Host(*parts) for parts in zip(opened, clocks, "ab", strict=True)]
    for transactions in opened:
        transactions.close()


@pytest.mark.parametrize("step_ms", [-HOUR_MS, 0, HOUR_MS])
def test_a_step_of_one_hosts_clock_ends_no_lease_of_the_other(hosts, step_ms):
    a, b = hosts
    for host in hosts:
        host.beat()
    a.write(lambda uow: uow.queue.enqueue(a_job()))
    lease = a.claim()
    b.clock.day_ns = b.clock.wall_ns() + step_ms * 1_000_000
    assert b.claim() is None
    assert b.write(lambda uow: uow.queue.fail_exhausted_jobs()) == []
    assert b.write(lambda uow: (uow.queue.forgive("worker-b-"), uow.queue.release("worker-b-1", "it fell over"))) == (
        0,
        0,
    )
    assert sorted(b.alive()) == ["worker-a-1", "worker-b-1"]
    a.write(lambda uow: uow.queue.complete(lease, {}))


def test_a_lease_that_has_run_out_by_the_stores_clock_is_taken_on_either_host(hosts):
    a, b = hosts
    a.write(lambda uow: uow.queue.enqueue(a_job()))
    late = a.claim()
    for host in hosts:
        assert host.claim() is None
    a.write(lambda uow: uow.connection.execute(text(LEASES_END), {"ms": LEASE_MS + 1}))
    taken = b.claim()
    assert taken.job.attempts == 2 and taken.job.lease_id != late.job.lease_id
    with pytest.raises(StaleLease):
        a.write(lambda uow: uow.queue.extend(late))


def test_two_hosts_share_the_time_of_tenants_and_neither_loses_any(hosts):
    for number in range(6):
        hosts[0].write(partial(enqueue, number=number))
    for _ in range(3):
        leases = [host.claim() for host in hosts]
        assert {lease.job.tenant for lease in leases} == {"anna", "bert"}
        for host, lease in zip(hosts, leases, strict=True):
            host.write(partial(complete, lease=lease))
    rows = hosts[0].write(lambda uow: uow.connection.execute(text("SELECT sum(ran_ms) FROM worker_turns")).scalar_one())
    assert rows >= 6


def test_workers_of_two_hosts_at_once_run_each_job_once(hosts):
    for number in range(40):
        hosts[0].write(partial(enqueue, number=number))
    run = []

    def work(host):
        while (lease := host.claim()) is not None:
            host.write(partial(complete, lease=lease))
            run.append((host.name, lease.job.operation_id))

    threads = [threading.Thread(target=work, args=(host,)) for host in hosts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(operation for _, operation in run) == sorted(f"op-{number}" for number in range(40))
    jobs = hosts[1].write(lambda uow: uow.jobs.of_all_tenants())
    assert {(job.state, job.attempts) for job in jobs} == {("DONE", 1)}


def enqueue(uow, number):
    uow.queue.enqueue(a_job(f"op-{number}", tenant=("anna", "bert")[number % 2]))


def complete(uow, lease):
    uow.queue.complete(lease, {})


def test_the_server_tells_the_time_of_its_store(postgres_url):
    clock = SteppedClock("boot", 0)
    store = PostgresTransactions(postgres_url, clock=clock)
    first = store.write(lambda uow: uow.now_ms()).result()
    eventually(lambda: store.read(lambda uow: uow.now_ms()).result() > first)
    store.close()


def test_a_transaction_that_has_lasted_asks_for_the_time_anew(postgres_url):
    store = PostgresTransactions(postgres_url, clock=SteppedClock("boot", 0))
    begun_ms, now_ms = store.write(lambda uow: (uow.now_ms(), time.sleep(2 * FRESH_S), now_of(uow))[::2]).result()
    assert now_ms >= begun_ms + 1900 * FRESH_S
    store.close()


def now_of(uow) -> int:
    """The time of the store as another member of the same group would ask for it."""
    return uow.engine.now_ms(uow.connection)


class Reboots:
    """A SQLite store that is opened in one boot after another."""

    def __init__(self, folder) -> None:
        self._database = made_database(folder / "revisit.db")

    def in_boot(self, clock, work):
        store = SqliteTransactions(self._database, checkpoints=True, clock=clock, lease_ms=LEASE_MS)
        try:
            return store.write(work).result()
        finally:
            store.close()


@pytest.mark.parametrize("day_ns", [0, 4 * 10**18])
def test_the_time_of_a_store_goes_on_after_a_reboot_whatever_the_wall_clock_says(tmp_path, day_ns):
    boots = Reboots(tmp_path)
    first = SteppedClock("boot-1", 9_000_000)
    boots.in_boot(first, lambda uow: (uow.queue.enqueue(a_job()), uow.queue.claim("worker-x-1")))
    first.ms += 2_000
    boots.in_boot(first, lambda uow: uow.workers.beat("worker-x-1", "m"))
    second = SteppedClock("boot-2", 3, day_ns)
    assert boots.in_boot(second, lambda uow: uow.now_ms()) == 2_000
    assert boots.in_boot(second, lambda uow: uow.queue.claim("worker-y-1")) is None
    second.ms += LEASE_MS - 2_000
    assert boots.in_boot(second, lambda uow: uow.queue.claim("worker-y-1")).job.attempts == 2
    assert boots.in_boot(first, lambda uow: uow.now_ms()) == 2_000
