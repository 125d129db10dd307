"""`revisit doctor` on PostgreSQL finds what it finds on SQLite: damaged rows, rows without a parent, missing blobs."""

from __future__ import annotations

import signal
from dataclasses import replace

import numpy as np
import pytest
from sqlalchemy import create_engine, text

from revisit.core.errors import DataLoss
from revisit.service.engines.postgres.examination import examine, newest_clouds
from revisit.service.engines.postgres.transactions import PostgresTransactions
from revisit.service.features.audit.calls import AuditEntry, append
from tests.support.records import TENANT, a_loop, a_map, a_scan, a_session, a_submap
from tests.support.stepped_clock import SteppedClock

UNIT = np.full(16, 0.25, dtype="<f4").tobytes()


def fill(uow):
    uow.maps.add(a_map())
    uow.sessions.add(a_session())
    uow.scans.add(replace(a_scan(), cloud_sha256="a" * 64))
    one, other = (uow.submaps.add(a_submap(name, ordinal=at, descriptor=UNIT)) for at, name in enumerate("ab"))
    uow.loops.add(a_loop(other.number, one.number))
    for number in range(3):
        append(uow, number, AuditEntry(TENANT, "bert", "keys_create", f"k{number}", {}))


@pytest.fixture
def filled(postgres_url):
    store = PostgresTransactions(postgres_url, clock=SteppedClock())
    store.write(fill).result()
    store.close()
    return postgres_url


def found(url, *, full=True, missing=()):
    def read(blob):
        if blob.sha256 in missing:
            raise DataLoss(f"the {blob.kind} is missing")
        return b""

    return {one.check: one for one in examine(url, read, full=full)}


def change(url, *statements):
    """As no service would: neither triggers nor references are asked."""
    engine = create_engine(url)
    with engine.begin() as connection:
        for statement in ("SET session_replication_role = replica", *statements):
            connection.execute(text(statement))
    engine.dispose()


def test_nothing_is_wrong_with_what_a_service_has_written(filled):
    told = found(filled)
    assert {one.ok for one in told.values()} == {True}
    assert set(told) == {"pages", "references", "rows", "blobs"}
    assert told["blobs"].detail.startswith("2 of 2 read, 0 missing")
    assert "rows" not in found(filled, full=False)


@pytest.mark.parametrize(
    ("statement", "check", "told"),
    [
        ("DELETE FROM sessions", "references", "3 rows whose parent is gone"),
        ("UPDATE submaps SET descriptor = overlay(descriptor placing '\\x00000042' from 1) WHERE ordinal = 1", "rows",
         "submaps 2"),
        ("UPDATE scans SET \"T_odom_sensor\" = '\\x99'", "rows", "scans: row "),
        ("UPDATE audit_log SET actor = 'eve' WHERE number = 2", "rows", "audit_log: "),
        ("DELETE FROM audit_log WHERE number = 3", "rows", "audit_log: "),
    ],
)  # fmt: skip
def test_a_changed_row_is_named(filled, statement, check, told):
    change(filled, statement)
    wrong = {one.check: one.detail for one in found(filled).values() if one.ok is False}
    assert list(wrong) == [check] and told in wrong[check]


def test_a_missing_blob_is_named(filled):
    wrong = found(filled, full=False, missing={"a" * 64})["blobs"]
    assert not wrong.ok and "1 missing or damaged: the cloud is missing" in wrong.detail


def test_the_newest_clouds_are_told_and_none_of_an_empty_database(filled, own_postgres):
    assert {blob.sha256[0] for blob in newest_clouds(filled, 5)} == {"a", "c"}
    assert newest_clouds(own_postgres.new_database("empty"), 5) == []


def test_a_flipped_bit_in_a_page_is_noticed(own_postgres):
    url = own_postgres.made_database()
    store = PostgresTransactions(url, clock=SteppedClock())
    store.write(fill).result()
    store.close()
    engine = create_engine(url)
    with engine.connect() as connection:
        file = connection.execute(text("SELECT pg_relation_filepath('scans')")).scalar_one()
    engine.dispose()
    own_postgres.stop(signal.SIGINT)
    path = own_postgres.folder / "data" / file
    page = bytearray(path.read_bytes())
    page[8000] ^= 1
    path.write_bytes(page)
    own_postgres.start()
    wrong = {one.check: one.detail for one in found(url).values() if one.ok is False}
    assert any("invalid page" in detail for detail in wrong.values()), wrong
