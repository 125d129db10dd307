"""What SQLite must do and does not do by default."""

from __future__ import annotations

import sqlite3
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import BigInteger, Integer, event
from sqlalchemy.exc import OperationalError

from revisit.service.domain.errors import NotFound, StorageFull, StorageUncertain
from revisit.service.engines.local.files.disk import FailStop
from revisit.service.engines.local.sqlite.connections import reader_engine, writer_engine
from revisit.service.engines.local.sqlite.migration import current_revision, migrate
from revisit.service.engines.local.sqlite.store_clock import boots
from revisit.service.engines.local.sqlite.transactions import SqliteTransactions
from revisit.service.engines.sql import tables
from tests.contract.test_transactions import fill
from tests.support.patience import PATIENCE_S
from tests.support.records import TENANT, a_job, a_map, a_session, a_submap


@pytest.fixture
def database(tmp_path):
    migrate(tmp_path / "test.db")
    return tmp_path / "test.db"


def rows(path) -> dict[str, list[tuple]]:
    connection = sqlite3.connect(path)
    names = [name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
    content = {name: connection.execute(f'SELECT * FROM "{name}"').fetchall() for name in names}
    connection.close()
    return content


def test_the_migration_goes_up_down_and_up_on_a_filled_database(database):
    store = SqliteTransactions(database, checkpoints=True)
    store.write(fill).result()
    store.write(lambda uow: uow.changes.record_described(uow.maps.get(TENANT, "town"), 1)).result()
    store.close()
    filled = rows(database)
    assert all(filled[name] for name in ("maps", "robots", "sessions", "scans", "submaps", "loop_closures"))
    migrate(database)
    assert rows(database) == filled
    migrate(database, "base")
    assert current_revision(database) is None
    assert set(rows(database)) <= {"alembic_version", "sqlite_sequence"}
    migrate(database)
    assert set(rows(database)) == set(filled)
    store = SqliteTransactions(database, checkpoints=True)
    assert store.write(lambda uow: uow.maps.add(a_map())).result().number == 1
    store.close()


def of_another_type(_context, _inspected, _declared, found, wanted):
    """As Alembic compares; a SQLite INTEGER has 64 bits."""
    return False if isinstance(found, Integer) and isinstance(wanted, BigInteger) else None


def test_the_migration_makes_the_schema_of_the_tables(database):
    engine = writer_engine(database, checkpoints=True)
    with engine.connect() as connection:
        # What the engine keeps for itself is in no table of the SQL that knows no engine.
        options = {"compare_type": of_another_type, "include_object": lambda _, name, *__: name != "checksum"}
        context = MigrationContext.configure(connection, opts=options)
        assert compare_metadata(context, [tables.metadata, boots.metadata]) == []
    engine.dispose()


def test_the_migrations_make_what_the_tables_cannot_say(database):
    """A number is never given out twice, and some indexes hold some rows only."""
    connection = sqlite3.connect(database)
    made = dict(connection.execute("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL"))
    connection.close()
    keyed_by_text = {table.name for table in tables.metadata.sorted_tables if "AUTOINCREMENT" not in made[table.name]}
    assert keyed_by_text == {"workers", "processes", "worker_turns", "map_counters", "webhook_positions"}
    indexes = [index for table in tables.metadata.sorted_tables for index in table.indexes]
    wanted = {index.name: index.info.get("where") for index in indexes}
    assert {name: made[name].partition(" WHERE ")[2] or None for name in wanted} == wanted
    assert "priority = 0" in wanted.values()


def test_the_writer_is_durable_and_one_process_checkpoints(database):
    def pragma(engine, name):
        with engine.connect() as connection:
            return connection.exec_driver_sql(f"PRAGMA {name}").scalar()

    gateway, worker = writer_engine(database, checkpoints=True), writer_engine(database, checkpoints=False)
    for engine in (gateway, worker):
        names = ("journal_mode", "synchronous", "foreign_keys")
        assert [pragma(engine, name) for name in names] == ["wal", 2, 1]
    assert (pragma(gateway, "wal_autocheckpoint"), pragma(worker, "wal_autocheckpoint")) == (4000, 0)
    gateway.dispose()
    worker.dispose()


def test_a_reader_cannot_write(database):
    engine = reader_engine(database)
    with engine.begin() as connection, pytest.raises(OperationalError, match="readonly"):
        connection.exec_driver_sql("DELETE FROM maps")
    engine.dispose()


def test_readers_keep_their_connections_and_let_go_of_one_that_failed(database):
    store, opened = SqliteTransactions(database, checkpoints=True), []
    event.listen(store._reader, "connect", lambda connection, _: opened.append(connection))

    def missing(uow):
        raise NotFound

    for _ in range(3):
        store.read_here(lambda uow: uow.maps.count(TENANT))
        with pytest.raises(NotFound):
            store.read_here(missing)
    assert len(opened) == 1
    store.read_here(lambda uow: store.read_here(lambda inner: inner.maps.count(TENANT)))
    assert len(opened) == 2
    with pytest.raises(StorageUncertain):
        store.read_here(lambda uow: uow.connection.exec_driver_sql("SELECT nothing"))
    assert len(store._idle) == 1
    store.close()
    assert not store._idle


def test_two_hundred_read_modify_writes_from_four_connections_lose_nothing(database):
    stores = [SqliteTransactions(database, checkpoints=number == 0) for number in range(4)]
    stores[0].write(lambda uow: (uow.maps.add(a_map()), uow.sessions.add(a_session()))).result()

    def count_up(uow):
        session = uow.sessions.get(TENANT, "town", "monday")
        uow.sessions.replace(replace(session, committed_seq=session.committed_seq + 1))

    def fifty(store):
        for _ in range(50):
            store.write(count_up).result()

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(fifty, stores))
    counted = stores[0].read(lambda uow: uow.sessions.get(TENANT, "town", "monday").committed_seq).result()
    for store in stores:
        store.close()
    assert counted == 200


def test_a_read_sees_one_snapshot_while_others_write(database):
    store, other = SqliteTransactions(database, checkpoints=True), SqliteTransactions(database, checkpoints=False)
    begun, written = threading.Event(), threading.Event()

    def look_twice(uow):
        first = uow.maps.count(TENANT)
        begun.set()
        assert written.wait(PATIENCE_S)
        return first, uow.maps.count(TENANT)

    looking = store.read(look_twice)
    assert begun.wait(PATIENCE_S)
    other.write(lambda uow: uow.maps.add(a_map())).result()
    written.set()
    assert looking.result() == (0, 0)
    assert store.read(lambda uow: uow.maps.count(TENANT)).result() == 1
    store.close()
    other.close()


def test_a_writer_that_does_not_get_its_turn_says_so_and_stores_nothing(database, monkeypatch):
    monkeypatch.setattr("revisit.service.engines.local.sqlite.transactions.LOCK_TIMEOUT_S", 0.1)
    store, other = SqliteTransactions(database, checkpoints=True), SqliteTransactions(database, checkpoints=False)
    entered, leave = threading.Event(), threading.Event()

    def hold(uow):
        entered.set()
        assert leave.wait(PATIENCE_S)

    holding = store.write(hold)
    assert entered.wait(PATIENCE_S)
    with pytest.raises(StorageUncertain, match="nothing was stored"):
        other.write(lambda uow: uow.maps.add(a_map())).result()
    leave.set()
    holding.result()
    assert store.read(lambda uow: uow.maps.count(TENANT)).result() == 0
    store.close()
    other.close()


def test_old_answers_are_found_without_looking_at_the_jobs_of_submaps(database):
    store = SqliteTransactions(database, checkpoints=True)
    statements = []

    def forget(uow):
        event.listen(uow.connection, "before_cursor_execute", lambda *seen: statements.append(seen[2:4]))
        uow.jobs.forget_answers(10, 5)
        ((statement, parameters),) = statements.copy()
        return [row.detail for row in uow.connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {statement}", parameters)]

    plan = store.write(forget).result()
    assert any("ix_jobs_finished_at_ns" in step for step in plan)
    assert not any(step.startswith("SCAN jobs") for step in plan)
    store.close()


@pytest.mark.parametrize("use", ["read", "revised"])
def test_submaps_are_found_by_number_without_looking_at_the_others_of_their_tenant(database, use):
    store = SqliteTransactions(database, checkpoints=True)
    statements = []

    def by_number(uow):
        uow.maps.add(a_map())
        uow.sessions.add(a_session())
        submaps = [uow.submaps.add(a_submap(name)) for name in ("a", "b")]
        event.listen(uow.connection, "before_cursor_execute", lambda *seen: statements.append(seen[2:4]))
        if use == "read":
            found = uow.submaps.numbered(TENANT, [submap.number for submap in submaps])
            assert found == {submap.number: submap for submap in submaps}
            assert uow.submaps.numbered("another", [submaps[0].number]) == {}
        else:
            uow.submaps.revise(submaps, ordinal=3)
        statement, parameters = statements[0]
        return [row.detail for row in uow.connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {statement}", parameters)]

    plan = store.write(by_number).result()
    assert plan[0].startswith("SEARCH submaps USING INTEGER PRIMARY KEY")
    store.close()


def _bury_one_whose_lease_is_lost(uow):
    uow.queue.claim("w1")
    uow.connection.exec_driver_sql("UPDATE jobs SET lease_expires_ms = 1 WHERE state = 'RUNNING'")
    uow.queue.fail_exhausted_jobs()


BY_INDEX = {
    "waits": lambda uow: uow.queue.waits(),
    "claim": lambda uow: uow.queue.claim("w1"),
    "bury": lambda uow: _bury_one_whose_lease_is_lost(uow),
    "release": lambda uow: uow.queue.release("w1", "it fell over"),
    "refer": lambda uow: uow.blobs.refer(TENANT, [("cloud", "f" * 64)]),
    "let go": lambda uow: uow.blobs.release(TENANT, {("cloud", "e" * 64)}),
    "collect": lambda uow: uow.blobs.begin(0, 5),
}


@pytest.mark.parametrize("call", BY_INDEX.values(), ids=BY_INDEX)
def test_the_queue_and_the_collection_of_blobs_look_through_no_table(database, call):
    store = SqliteTransactions(database, checkpoints=True)
    sent = []

    def plans(uow):
        uow.queue.enqueue(a_job())
        uow.blobs.release(TENANT, {("cloud", "f" * 64)})
        event.listen(uow.connection, "before_cursor_execute", lambda *seen: sent.append(seen[2:4]))
        call(uow)
        asked = [one for one in sent if one[0].startswith(("SELECT", "UPDATE", "DELETE", "WITH"))]
        explain = uow.connection.exec_driver_sql
        return [row.detail for one in asked for row in explain(f"EXPLAIN QUERY PLAN {one[0]}", one[1])]

    plan = store.write(plans).result()
    store.close()
    assert plan
    looked_through = {step.split()[1] for step in plan if step.startswith("SCAN ") and " USING " not in step}
    # The turns of a dead worker are found among those of the workers that there are.
    assert looked_through & {*tables.metadata.tables} <= {"worker_turns"}


def test_a_full_database_refuses_and_takes_writes_again_when_there_is_room(database):
    store = SqliteTransactions(database, checkpoints=True)

    def limit_pages(uow, pages):
        return uow.connection.exec_driver_sql(f"PRAGMA max_page_count={pages}").scalar()

    def add_many(uow):
        for number in range(400):
            uow.maps.add(replace(a_map(f"m{number}"), display_name="x" * 250))

    store.write(lambda uow: limit_pages(uow, 1)).result()
    with pytest.raises(StorageFull):
        store.write(add_many).result()
    assert store.read(lambda uow: uow.maps.count(TENANT)).result() == 0
    store.write(lambda uow: limit_pages(uow, 100_000)).result()
    store.write(add_many).result()
    assert store.read(lambda uow: uow.maps.count(TENANT)).result() == 400
    store.close()


def test_an_input_output_error_is_uncertain_and_calls_for_a_restart(database):
    called = []
    store = SqliteTransactions(database, checkpoints=True, fail_stop=FailStop(lambda: called.append(True)))

    def breaks(uow):
        error = sqlite3.OperationalError("disk I/O error")
        error.sqlite_errorname = "SQLITE_IOERR_FSYNC"
        raise OperationalError("COMMIT", {}, error)

    with pytest.raises(StorageUncertain, match="disk I/O error"):
        store.write(breaks).result()
    assert called == [True]
    with pytest.raises(StorageUncertain, match="restarting"):
        store.write(lambda uow: uow.maps.add(a_map())).result()
    assert store.read(lambda uow: uow.maps.count(TENANT)).result() == 0
    store.close()
