"""PostgreSQL: two processes that write at the same time lose nothing of each other, and never wait for each other."""

from __future__ import annotations

import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from sqlalchemy import create_engine, text
from sqlalchemy.exc import DBAPIError

from revisit.service.domain.errors import AlreadyExists, StorageUncertain
from revisit.service.domain.identity import TenantId
from revisit.service.engines.postgres import connections
from revisit.service.engines.postgres.transactions import PostgresTransactions
from revisit.service.features.audit.calls import AuditEntry, append, judge
from tests.support.patience import PATIENCE_S, eventually, in_time
from tests.support.records import TENANT, a_job, a_map
from tests.support.stepped_clock import SteppedClock


@pytest.fixture
def two(postgres_url):
    """The stores of two processes."""
    stores = [PostgresTransactions(postgres_url, clock=SteppedClock("boot", 0)) for _ in range(2)]
    yield stores
    for store in stores:
        store.close()


def counted(uow, map_id: str = "town") -> None:
    """Read a record, and write what follows from it."""
    known = uow.maps.get(TENANT, map_id, hold=True)
    uow.maps.replace(replace(known, graph_edits=known.graph_edits + 1))


def names(store) -> list[str]:
    return [record.map_id for record in store.read(lambda uow: uow.maps.find(TENANT)).result()]


def test_what_two_processes_count_in_one_record_is_counted_once_each(two):
    two[0].write(lambda uow: uow.maps.add(a_map())).result()
    for future in [store.write(counted) for _ in range(40) for store in two]:
        future.result(PATIENCE_S)
    assert two[0].read(lambda uow: uow.maps.get(TENANT, "town")).result().graph_edits == 80


def test_a_writer_that_stops_in_its_transaction_keeps_its_rows_from_nobody(postgres_url, monkeypatch):
    monkeypatch.setattr(connections, "IDLE_S", 1)
    stores = [PostgresTransactions(postgres_url, clock=SteppedClock("boot", 0)) for _ in range(2)]
    stores[1].write(lambda uow: uow.maps.add(a_map())).result()
    held, goes_on = threading.Event(), threading.Event()

    def stop(uow):
        counted(uow)
        held.set()
        goes_on.wait(PATIENCE_S)
        counted(uow)

    stopped = stores[0].write(stop)
    assert held.wait(PATIENCE_S)
    freed_s = eventually(lambda: stores[1].write(counted).exception(PATIENCE_S) is None, "its rows are kept")
    assert in_time(freed_s, 5.0)
    goes_on.set()
    with pytest.raises(StorageUncertain):
        stopped.result(PATIENCE_S)
    assert stores[1].read(lambda uow: uow.maps.get(TENANT, "town")).result().graph_edits == 1
    for store in stores:
        store.close()


def test_groups_that_need_the_same_records_in_another_order_never_wait_for_each_other(two):
    orders = (["a", "b"], ["b", "a"])
    two[0].write(lambda uow: [uow.maps.add(a_map(name)) for name in "ab"]).result()
    writes = [
        store.write(lambda uow, name=name: counted(uow, name))
        for _ in range(20)
        for store, order in zip(two, orders, strict=True)
        for name in order
    ]
    for write in writes:
        write.result(PATIENCE_S)
    found = two[1].read(lambda uow: uow.maps.find(TENANT)).result()
    assert [record.graph_edits for record in found] == [40, 40]
    deadlocks = text("SELECT deadlocks FROM pg_stat_database WHERE datname = current_database()")
    assert two[0].read(lambda uow: uow.connection.execute(deadlocks).scalar()).result() == 0


def test_a_member_that_has_to_wait_keeps_nobody_of_its_group_waiting(two):
    holds, leave, first, other = threading.Event(), threading.Event(), two[0], two[1]
    first.write(lambda uow: [uow.maps.add(a_map(name)) for name in ("town", "yard")]).result()

    def holding(uow):
        counted(uow)
        holds.set()
        assert leave.wait(PATIENCE_S)

    held = first.write(holding)
    assert holds.wait(PATIENCE_S)
    with ThreadPoolExecutor(1) as pool:
        entered = threading.Event()
        gate = other.write(lambda uow: entered.wait(PATIENCE_S))
        yard, town = other.write(lambda uow: counted(uow, "yard")), other.write(counted)
        entered.set()
        assert gate.result(PATIENCE_S)
        yard.result(PATIENCE_S)
        assert not town.done()
        pool.submit(leave.set)
    held.result(PATIENCE_S)
    town.result(PATIENCE_S)
    assert first.read(lambda uow: uow.maps.get(TENANT, "town")).result().graph_edits == 2


def test_a_row_that_another_process_has_just_added_is_seen_by_the_next_run(two):
    both_read, runs = threading.Barrier(2), []

    def post(uow):
        """As use cases do: the same again is no error."""
        if uow.maps.get(TENANT, "town") is not None:
            return "known"
        runs.append(1)
        if len(runs) <= 2:
            both_read.wait(PATIENCE_S)
        uow.maps.add(a_map())
        return "new"

    answers = [future.result(PATIENCE_S) for future in [store.write(post) for store in two]]
    assert sorted(answers) == ["known", "new"]


def test_a_key_that_is_taken_stays_an_error_of_its_own_work(two):
    two[0].write(lambda uow: uow.maps.add(a_map())).result()
    futures = [two[1].write(lambda uow, name=name: uow.maps.add(a_map(name))) for name in ("a", "town", "b")]
    with pytest.raises(AlreadyExists):
        futures[1].result(PATIENCE_S)
    assert [futures[0].result().map_id, futures[2].result().map_id] == ["a", "b"]
    assert names(two[0]) == ["town", "a", "b"]


def test_the_chain_of_the_audit_log_has_one_order_however_many_processes_append(two):
    entry = AuditEntry(TENANT, "somebody", "key_created", "keys/k", {})
    writes = [store.write(lambda uow, at=at: append(uow, at, entry)) for at in range(30) for store in two]
    for write in writes:
        write.result(PATIENCE_S)
    verdict = two[0].read(lambda uow: judge(uow.audit.since(0, 100), uow.audit.highest())).result()
    assert (verdict.rows, verdict.fault) == (60, None)


@pytest.mark.parametrize("change", ["UPDATE audit_log SET actor = 'x'", "DELETE FROM audit_log", "TRUNCATE audit_log"])
def test_nobody_changes_a_row_of_the_audit_log(two, postgres_url, change):
    two[0].write(lambda uow: append(uow, 1, AuditEntry(TENANT, "a", "key_created", "keys/k", {}))).result()
    engine = create_engine(postgres_url)
    with pytest.raises(DBAPIError, match="append-only"), engine.begin() as connection:
        connection.execute(text(change))
    engine.dispose()


def test_what_need_not_survive_a_power_cut_waits_for_no_sync_unless_something_beside_it_must(two):
    def how_it_commits(uow):
        return uow.connection

    told = []
    store = two[0]
    savepoints = store._writing._savepoints
    before = savepoints.before_commit

    def noting(connection, *, durable):
        before(connection, durable=durable)
        told.append(connection.execute(text("SHOW synchronous_commit")).scalar())

    savepoints.before_commit = noting
    usual = store.read(lambda uow: uow.connection.execute(text("SHOW synchronous_commit")).scalar()).result()
    store.write(how_it_commits, durable=False).result()
    store.write(how_it_commits).result()
    assert told == ["off", usual]


def test_the_embedded_default_imports_nothing_of_postgresql():
    code = (
        "import sys; from revisit.service import composition, gateway, __main__; import revisit.cli; "
        "print(*(name for name in sys.modules if 'psycopg' in name or 'postgres' in name))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_every_job_is_claimed_once_however_many_workers_ask_at_the_same_time(two, postgres_url):
    stores = [*two, *(PostgresTransactions(postgres_url, clock=SteppedClock("boot", 0)) for _ in range(2))]
    ids = [f"op-{number}" for number in range(60)]
    jobs = [a_job(name, tenant=TenantId(f"fleet-{n % 3}")) for n, name in enumerate(ids)]
    two[0].write(lambda uow: [uow.queue.enqueue(job) for job in jobs]).result()

    def work(store) -> list[str]:
        claimed = []
        while (lease := store.write(lambda uow: uow.queue.claim(f"w{id(store)}"), durable=False).result()) is not None:
            claimed.append(lease.job.operation_id)
            store.write(lambda uow, lease=lease: uow.queue.complete(lease, {})).result()
        return claimed

    with ThreadPoolExecutor(len(stores)) as pool:
        claimed = [name for names in pool.map(work, stores) for name in names]
    for store in stores[2:]:
        store.close()
    assert sorted(claimed) == sorted(ids)
