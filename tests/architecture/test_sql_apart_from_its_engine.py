"""service/engines/sql knows no engine: its statements compile for PostgreSQL and run without the SQLite package."""

from __future__ import annotations

import inspect
import re
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import event
from sqlalchemy.dialects import postgresql
from sqlalchemy.schema import CreateIndex, CreateTable

from revisit.service.domain.events import EventRecord
from revisit.service.domain.records import TurnRecord
from revisit.service.domain.webhooks import WebhookRecord
from revisit.service.engines.sql import (
    access,
    blob_addresses,
    blob_rows,
    change_log,
    event_log,
    jobs,
    loops,
    map_counters,
    repositories,
    tables,
    turns,
    webhooks,
    worker_log,
)
from revisit.service.engines.sql.turns import SqlTenantTurns
from revisit.service.ports.access import AuditRecord, KeyRecord
from tests.contract.test_transactions import fill
from tests.support.plain_engine import HIGHEST, PlainTransactions
from tests.support.records import TENANT, a_job, a_map, a_submap
from tests.support.sources import modules

SQL = Path(__file__).resolve().parents[2] / "service" / "engines" / "sql"
DIALECT = re.compile(
    r"sqlite|postgres|\bdialects?\.|pragma|rowid|insert or|on conflict|savepoint|json_|\bglob\b|exec_driver_sql",
    re.IGNORECASE,
)
ABOVE_ENGINES = ("domain", "ports", "capacity", "features", "wire", "calls", "edge", "rest", "grpc", "worker")
WORDS_OF_ENGINES = re.compile(r"(?<![a-z])(?:wal(?![a-z])|flock|sqlite_sequence|boot_?ids?|epoch)", re.IGNORECASE)
NOW_MS = 1
KEY = KeyRecord(TENANT, "k1", "label", ("read",), "0" * 64, 1, None, None, None)
ROW = AuditRecord(1, 1, TENANT, "actor", "keys.create", "k1", {}, "", "0" * 64)
HOOK = WebhookRecord(TENANT, "hook", "hash", "https://example.org", None, (), "secret", "ENABLED", 0, 0, 0, 1)
ACROSS_TENANTS = {
    ("submaps", "state"),
    ("loop_closures", "query_number"),
    ("loop_closures", "match_number"),
    ("loop_events", "query_number"),
    ("loop_events", "match_number"),
    ("jobs", "state"),
    ("jobs", "finished_at_ns"),
    ("unreferenced_blobs", "state"),
    ("worker_turns", "started_ms"),
    ("webhook_positions", "webhook_number"),
}
"""Table and first column of the indexes and keys that do not begin with the tenant; `tables` says why."""

KEYED_OTHERWISE = ("workers", "processes", "worker_turns", "map_counters", "webhook_positions")
CALLS = {
    "SqlRepository.add": fill,
    "SqlRepository.get": lambda uow: [uow.maps.get(TENANT, "town", hold=hold) for hold in (False, True)],
    "SqlRepository.find": lambda uow: uow.sessions.find(TENANT, after=0, limit=5, map_id="town", robot_id=None),
    "SqlRepository.numbered": lambda uow: uow.submaps.numbered(TENANT, [1, 2]),
    "SqlRepository.distinct": lambda uow: uow.submaps.distinct(TENANT, "cloud_sha256", map_id="town"),
    "SqlRepository.count": lambda uow: uow.submaps.count(TENANT, state="QUEUED"),
    "SqlRepository.damaged": lambda uow: uow.maps.damaged(TENANT, map_id="town"),
    "SqlRepository.count_of_all_tenants": lambda uow: uow.jobs.count_of_all_tenants(state="QUEUED"),
    "SqlRepository.of_all_tenants": lambda uow: uow.maps.of_all_tenants(limit=5),
    "SqlRepository.replace": lambda uow: uow.maps.replace(uow.maps.get(TENANT, "town")),
    "SqlRepository.replace_all": lambda uow: uow.maps.replace_all(uow.maps.find(TENANT)),
    "SqlRepository.add_all": lambda uow: uow.maps.add_all([a_map("city")]),
    "SqlRepository.revise": lambda uow: uow.maps.revise(uow.maps.find(TENANT), display_name=""),
    "SqlRepository.some": lambda uow: uow.everything.scans.some(TENANT, 5, map_id="town"),
    "SqlRepository.delete_some": lambda uow: uow.loops.delete_some(TENANT, 5, "query_number", [1, 2]),
    "SqlRepository.delete": lambda uow: uow.loops.delete(TENANT, map_id="town"),
    "SqlScans.around": lambda uow: uow.scans.around(TENANT, "town", "monday", 1, 9),
    "SqlScans.chosen_between": lambda uow: uow.scans.chosen_between(TENANT, "town", "monday", 1, 9),
    "SqlScans.first_seq_from": lambda uow: uow.scans.first_seq_from(TENANT, "town", "monday", 0.5),
    "SqlScans.points_of": lambda uow: uow.scans.points_of(TENANT),
    "SqlSubmaps.points_of": lambda uow: uow.submaps.points_of(TENANT),
    "SqlPlans.bytes_of": lambda uow: uow.plans.bytes_of(TENANT),
    "SqlScans.with_seqs": lambda uow: uow.scans.with_seqs(TENANT, "town", "monday", [1, 2]),
    "SqlSubmaps.placed": lambda uow: uow.submaps.placed(TENANT, "town"),
    "SqlSubmaps.add": lambda uow: uow.submaps.add(a_submap(submap_id="another")),
    "SqlSubmaps.last_seq": lambda uow: uow.submaps.last_seq(TENANT, "town"),
    "SqlSubmaps.flag_counts": lambda uow: uow.submaps.flag_counts(TENANT, "town", "monday"),
    "SqlSubmaps.found": lambda uow: uow.submaps.found(TENANT, [1]),
    "SqlSubmaps.path": lambda uow: [uow.submaps.path(TENANT, "town", "monday", 0, 5, back=back) for back in (0, 1)],
    "SqlLoops.accepted": lambda uow: uow.loops.accepted(TENANT, "town", after=1, limit=5, graph_state=None),
    "SqlLoops.measured": lambda uow: uow.loops.measured(TENANT, "town", after=1, limit=5),
    "SqlLoops.telling": lambda uow: uow.loops.telling(TENANT, [1, 2], ["AMBIGUOUS"]),
    "SqlLoops.rejected": lambda uow: uow.loops.rejected(TENANT, "town", ["LOW_OVERLAP"], after=1, limit=5),
    "SqlLoops.reasons": lambda uow: uow.loops.reasons(TENANT, [1, 2]),
    "SqlSubmaps.standings": lambda uow: [uow.submaps.standings(TENANT, "town", one) for one in (None, "monday")],
    "SqlSubmaps.first_waiting": lambda uow: uow.submaps.first_waiting(TENANT, "town"),
    "SqlSubmaps.first_unsearched": lambda uow: uow.submaps.first_unsearched(TENANT, "town"),
    "SqlJobs.unfinished": lambda uow: uow.jobs.unfinished(TENANT, {"op-1", "op-2"}),
    "SqlJobs.next_runnable": lambda uow: (uow.jobs.next_runnable(NOW_MS, TENANT, hold=True), uow.jobs.add(a_job())),
    "SqlJobs.exhausted": lambda uow: uow.jobs.exhausted(NOW_MS, hold=True),
    "SqlJobs.exchange": lambda uow: uow.jobs.exchange(a_job(), a_job(attempts=2)),
    "SqlJobs.leased_to": lambda uow: uow.jobs.leased_to("worker"),
    "SqlJobs.fail_damaged": lambda uow: uow.jobs.fail_damaged("DATA_LOSS", "damaged", 1),
    "SqlJobs.forget_answers": lambda uow: uow.jobs.forget_answers(5, 10),
    "SqlJobs.waiting": lambda uow: uow.jobs.waiting(),
    "SqlTenantTurns.standing": lambda uow: SqlTenantTurns(uow.connection, uow.engine).standing(),
    "SqlTenantTurns.of_worker": lambda uow: SqlTenantTurns(uow.connection, uow.engine).of_worker("w"),
    "SqlTenantTurns.add": lambda uow: SqlTenantTurns(uow.connection, uow.engine).add(TurnRecord(TENANT, 1, 2), "w"),
    "SqlTenantTurns.forget": lambda uow: SqlTenantTurns(uow.connection, uow.engine).forget("w"),
    "SqlTenantTurns.mend": lambda uow: SqlTenantTurns(uow.connection, uow.engine).mend(),
    "SqlBlobRows.release": lambda uow: uow.blobs.release(TENANT, {("cloud", "f" * 64)}),
    "SqlBlobRows.strays": lambda uow: uow.blobs.strays(TENANT, {("cloud", "f" * 64)}),
    "SqlBlobRows.begin": lambda uow: uow.blobs.end(uow.blobs.begin(0, 5), [1]),
    "SqlBlobRows.end": lambda uow: None,
    "SqlBlobRows.put_again": lambda uow: uow.blobs.put_again([1]),
    "SqlBlobRows.refer": lambda uow: uow.blobs.refer(TENANT, {("cloud", "e" * 64)}),
    "SqlChangeLog.record_described": lambda uow: uow.changes.record_described(a_map(), 1),
    "SqlChangeLog.record_removed": lambda uow: uow.changes.record_removed(a_map(), [1, 2]),
    "SqlChangeLog.record_session_removed": lambda uow: uow.changes.record_session_removed(a_map(), 1),
    "SqlChangeLog.since": lambda uow: uow.changes.since(TENANT, 1, 0, 5),
    "SqlMaps.add": lambda uow: uow.maps.add(a_map("gone")),
    "SqlMaps.delete": lambda uow: uow.maps.delete(TENANT, map_id="gone"),
    "SqlEventLog.record": lambda uow: uow.events.record(EventRecord(TENANT, "town", "OPERATION", "op-1")),
    "SqlEventLog.following": lambda uow: uow.events.following(TENANT, "town", 0, 5),
    "SqlEventLog.last_numbers": lambda uow: uow.events.last_numbers([(TENANT, "town")]),
    "SqlEventLog.forget": lambda uow: uow.events.forget(0),
    "SqlWebhooks.add": lambda uow: uow.webhooks.add(HOOK),
    "SqlWebhooks.due": lambda uow: uow.webhooks.due(1),
    "SqlWebhooks.news": lambda uow: uow.webhooks.news(HOOK),
    "SqlWebhooks.tell": lambda uow: uow.webhooks.tell(HOOK, {"town": 1}),
    "SqlWebhooks.delete": lambda uow: uow.webhooks.delete(TENANT, webhook_id="hook"),
    "SqlWorkerLog.beat": lambda uow: uow.workers.beat("w", "v"),
    "SqlWorkerLog.alive": lambda uow: uow.workers.alive(0),
    "SqlWorkerLog.silent": lambda uow: uow.workers.silent(0),
    "SqlWorkerLog.forget": lambda uow: uow.workers.forget("w"),
    "SqlKeyRing.add": lambda uow: uow.keys.add(KEY),
    "SqlKeyRing.get": lambda uow: uow.keys.get("k1"),
    "SqlKeyRing.all": lambda uow: uow.keys.all(),
    "SqlKeyRing.replace": lambda uow: uow.keys.replace(uow.keys.get("k1")),
    "SqlKeyRing.is_empty": lambda uow: uow.keys.is_empty(),
    "SqlAuditTrail.append": lambda uow: uow.audit.append(ROW),
    "SqlAuditTrail.last": lambda uow: uow.audit.last(),
    "SqlAuditTrail.since": lambda uow: uow.audit.since(0, 5),
    "SqlAuditTrail.highest": lambda uow: uow.audit.highest(),
}
"""A call of each method, in an order in which all find what they need."""

EVERY_SUBMAP = (
    "SqlRepository.numbered", "SqlRepository.revise", "SqlScans.chosen_between", "SqlScans.first_seq_from",
    "SqlSubmaps.found", "SqlSubmaps.last_seq", "SqlSubmaps.path", "SqlSubmaps.placed", "SqlLoops.accepted",
    "SqlLoops.telling", "SqlJobs.unfinished", "SqlBlobRows.refer",
)  # fmt: skip
"""What a worker asks for with each submap: building a statement takes longer than running it."""


@pytest.fixture(scope="module")
def statements():
    """All that the calls have sent, once each, but for what the engine itself sends."""
    store, sent = PlainTransactions(lease_ms=1), {}

    def note(_connection, statement, *_rest) -> None:
        sent.setdefault(str(statement), statement)

    event.listen(store.database, "before_execute", note)
    for call in CALLS.values():
        store.write(call).result()
    store.close()
    del sent[str(HIGHEST)]
    return [*sent.values(), blob_addresses.blob_addresses()]


def test_nothing_above_an_engine_knows_how_it_keeps_its_log_its_locks_and_its_time():
    texts = {module.name: module.text for module in modules(*(f"service/{folder}" for folder in ABOVE_ENGINES))}
    assert len(texts) > 200
    assert {name: found for name, text in texts.items() if (found := WORDS_OF_ENGINES.findall(text))} == {}
    assert WORDS_OF_ENGINES.findall("WAL_ALARM wal_bytes walls") == ["WAL", "wal"]


def test_statements_of_every_submap_are_built_once():
    store, sent = PlainTransactions(lease_ms=1), list[Any]()
    store.write(fill).result()
    event.listen(store.database, "before_execute", lambda _connection, statement, *_rest: sent.append(statement))
    for name in EVERY_SUBMAP:
        sent.clear()
        for _ in range(2):
            store.write(CALLS[name]).result()
        first, second = sent[: len(sent) // 2], sent[len(sent) // 2 :]
        assert all(one is other for one, other in zip(first, second, strict=True)), name
    store.close()


def for_postgresql(statement) -> str:
    return str(statement.compile(dialect=postgresql.dialect()))


def test_every_method_of_the_repositories_is_called():
    modules = (access, blob_rows, change_log, event_log, jobs, loops, map_counters)
    modules += (repositories, turns, webhooks, worker_log)
    public = {
        f"{name}.{method}"
        for module in modules
        for name, found in inspect.getmembers(module, inspect.isclass)
        if found.__module__ == module.__name__
        for method in vars(found)
        if not method.startswith("_")
    }
    assert public == set(CALLS)


def test_every_statement_compiles_for_postgresql(statements):
    texts = [for_postgresql(statement) for statement in statements]
    assert len(texts) >= 40
    assert not [text for text in texts if "?" in text or DIALECT.search(text)]


@pytest.mark.parametrize("table", tables.metadata.sorted_tables, ids=lambda table: table.name)
def test_every_table_compiles_for_postgresql(table):
    assert "SERIAL" in for_postgresql(CreateTable(table)) or table.name in KEYED_OTHERWISE
    assert all(index.name in for_postgresql(CreateIndex(index)) for index in table.indexes)


@pytest.mark.parametrize("path", sorted(SQL.glob("*.py")), ids=lambda path: path.name)
def test_no_module_of_sql_speaks_a_dialect(path):
    assert DIALECT.findall(path.read_text()) == []


@pytest.mark.parametrize(
    "text", ["SELECT seq FROM sqlite_sequence", "INSERT OR REPLACE", "PRAGMA user_version", "json_extract(a, '$.b')"]
)
def test_the_search_itself_finds_what_it_should(text):
    assert DIALECT.search(text)


def test_every_index_begins_with_the_tenant_but_those_that_the_tables_explain():
    of_tenants = [table for table in tables.metadata.tables.values() if "tenant" in table.c]
    keys = [index for table in of_tenants for index in (*table.indexes, table.primary_key)]
    first = {(key.table.name, next(iter(key.columns)).name) for key in keys}
    assert {found for found in first if found[1] not in ("tenant", "number")} == ACROSS_TENANTS
