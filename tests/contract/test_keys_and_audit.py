"""The contracts of KeyRing and AuditTrail, and what the audit log's hashes find out."""

from __future__ import annotations

import sqlite3
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest

from revisit.service.domain.errors import AlreadyExists, NotFound
from revisit.service.domain.identity import TenantId
from revisit.service.engines.local.sqlite.migration import migrate
from revisit.service.engines.local.sqlite.transactions import SqliteTransactions
from revisit.service.features.audit import calls as audit
from revisit.service.features.audit.calls import NOTHING_BEFORE, AuditEntry, judge
from revisit.service.ports.access import KeyRecord

KEY = KeyRecord(TenantId("acme"), "abcdefabcdef", "robot 7", ("ingest", "query"), "0" * 64, 5, None, None)


def an_entry(number=1):
    return AuditEntry("acme", "key abcdefabcdef", "map_deleted", f"maps/m{number}", {"count": number})


def add_rows(uow, count=5):
    for number in range(1, count + 1):
        audit.append(uow, 1000 + number, an_entry(number))


def test_a_key_is_read_back_and_its_id_is_taken_for_every_tenant(write, read):
    assert read(lambda uow: uow.keys.is_empty())
    added = write(lambda uow: uow.keys.add(KEY))
    assert added == replace(KEY, number=1)
    assert read(lambda uow: uow.keys.get(KEY.key_id)) == added
    assert read(lambda uow: uow.keys.get("another")) is None
    assert not read(lambda uow: uow.keys.is_empty())
    with pytest.raises(AlreadyExists):
        write(lambda uow: uow.keys.add(replace(KEY, tenant=TenantId("other"))))


def test_a_key_is_replaced_by_its_number(write, read):
    added = write(lambda uow: uow.keys.add(KEY))
    write(lambda uow: uow.keys.replace(replace(added, revoked_at_ns=9, successor_id="b")))
    assert [(key.revoked_at_ns, key.successor_id) for key in read(lambda uow: uow.keys.all())] == [(9, "b")]
    with pytest.raises(NotFound):
        write(lambda uow: uow.keys.replace(replace(added, number=99)))


def test_audit_rows_follow_each_other_and_are_read_in_order(write, read):
    write(add_rows)
    rows = read(lambda uow: uow.audit.since(0, 100))
    assert [row.number for row in rows] == [1, 2, 3, 4, 5]
    assert [row.number for row in read(lambda uow: uow.audit.since(2, 2))] == [3, 4]
    assert rows[0].previous_hash == NOTHING_BEFORE
    assert [row.previous_hash for row in rows[1:]] == [row.hash for row in rows[:-1]]
    assert read(lambda uow: uow.audit.last()) == rows[-1]
    assert read(lambda uow: uow.audit.highest()) == 5
    verdict = judge(rows, 5)
    assert (verdict.rows, verdict.head, verdict.fault) == (5, rows[-1].hash, None)


def test_a_row_that_is_rolled_back_leaves_no_gap(write, read):
    def fails(uow):
        audit.append(uow, 1, an_entry())
        raise RuntimeError("half way")

    write(lambda uow: add_rows(uow, 2))
    with pytest.raises(RuntimeError, match="half way"):
        write(fails)
    write(lambda uow: audit.append(uow, 9, an_entry(3)))
    assert judge(read(lambda uow: uow.audit.since(0, 100)), read(lambda uow: uow.audit.highest())).fault is None


def test_rows_of_several_processes_make_one_chain(tmp_path):
    migrate(tmp_path / "a.db")
    stores = [SqliteTransactions(tmp_path / "a.db", checkpoints=number == 0) for number in range(3)]

    def twenty(store):
        for number in range(20):
            store.write(lambda uow, number=number: audit.append(uow, number, an_entry(number))).result()

    with ThreadPoolExecutor(3) as pool:
        list(pool.map(twenty, stores))
    verdict = stores[0].read(lambda uow: judge(uow.audit.since(0, 100), uow.audit.highest())).result()
    for store in stores:
        store.close()
    assert (verdict.rows, verdict.fault) == (60, None)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda rows: [*rows[:2], replace(rows[2], subject="maps/other"), *rows[3:]], "row 3 was changed"),
        (lambda rows: [*rows[:2], replace(rows[2], at_ns=0), *rows[3:]], "row 3 was changed"),
        (lambda rows: [*rows[:2], *rows[3:]], "row 3 is missing"),
        (lambda rows: rows[1:], "row 1 is missing"),
        (lambda rows: rows[:-1], "rows 5 to 5 are missing"),
        (lambda rows: [], "rows 1 to 5 are missing"),
        (lambda rows: [rows[1], rows[0], *rows[2:]], "row 1 is missing"),
    ],
    ids=["another subject", "another time", "one taken out", "first gone", "last gone", "all gone", "swapped"],
)
def test_every_edit_of_the_rows_is_found(write, read, change, fault):
    write(add_rows)
    rows = read(lambda uow: uow.audit.since(0, 100))
    assert judge(change(rows), 5).fault == fault


def test_a_row_with_a_hash_made_to_fit_breaks_the_link_of_the_next(write, read):
    write(add_rows)
    rows = read(lambda uow: uow.audit.since(0, 100))
    forged = replace(rows[2], actor="somebody else")
    forged = replace(forged, hash=audit.row_hash(forged))
    assert judge([*rows[:2], forged, *rows[3:]], 5).fault == "row 4 was changed"


@pytest.mark.parametrize("statement", ["UPDATE audit_log SET actor = 'x' WHERE number = 1", "DELETE FROM audit_log"])
def test_the_database_refuses_to_change_a_row(tmp_path, statement):
    migrate(tmp_path / "a.db")
    store = SqliteTransactions(tmp_path / "a.db", checkpoints=True)
    store.write(add_rows).result()
    store.close()
    connection = sqlite3.connect(tmp_path / "a.db")
    with pytest.raises(sqlite3.IntegrityError, match="append-only"):
        connection.execute(statement)
    connection.close()
