"""Retention is cut off anywhere, tells what it did, holds the lock of the writers briefly, and gives the disk back."""

from __future__ import annotations

from contextlib import contextmanager

import pytest

from revisit.service.domain.identity import SessionKey
from revisit.service.domain.retention import RetentionRule, parsed
from revisit.service.domain.states import EventKind
from revisit.service.engines.local.sqlite.transactions import SqliteTransactions
from revisit.service.features.events.calls import events_of
from revisit.service.features.retention.reports import SCAN_ROW_BYTES, RetentionReport
from tests.support.retained import (
    DAY_MS,
    blobs_of,
    cut_off_and_finished,
    disk_bytes,
    driven,
    kept_scans,
    policy_set,
    retained,
    stored_seqs,
)
from tests.support.service_world import SESSION, TENANT, sqlite_world
from tests.support.stored_rows import run

SCANS = 60
MOST_ROWS = 700
"""Rows that one transaction may change: at 100 us a row it takes 70 ms."""

ALL_RULES = "scans=none,rejected=1d,best=1"
POINTS = ("commit.before", "commit.after", "delete.after_rows")


@pytest.fixture
def world(tmp_path):
    made = sqlite_world(tmp_path)
    yield made
    made.context.transactions.close()


async def driven_and_due(world, scans: int = SCANS) -> None:
    await driven(world, scans)
    world.clock.ms += 2 * DAY_MS


@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize("nth", [1, pytest.param(2, marks=pytest.mark.slow), 4])
async def test_a_run_that_was_cut_off_is_finished_by_the_next_process(world, point, nth):
    await driven_and_due(world)
    await policy_set(world, ALL_RULES)
    await cut_off_and_finished(world, f"{point}=raise@{nth}")
    assert stored_seqs(world) == [] and set(kept_scans(world)) == {"NONE"}
    assert blobs_of(world, "cloud") == 0
    assert run(world.home / "revisit.db", "PRAGMA foreign_key_check") == []


@pytest.mark.slow
async def test_no_transaction_of_a_run_changes_many_rows(world, monkeypatch):
    await driven_and_due(world, 700)
    changed, transaction = [], SqliteTransactions._transaction

    @contextmanager
    def counted(self):
        with transaction(self) as connection:
            before = connection.connection.dbapi_connection.total_changes
            yield connection
            changed.append(connection.connection.dbapi_connection.total_changes - before)

    monkeypatch.setattr(SqliteTransactions, "_transaction", counted)
    transactions = world.context.transactions
    monkeypatch.setattr(transactions, "_writing", type(transactions._writing)(transactions._transaction))
    await retained(world, ALL_RULES)
    assert sum(changed) > 700 and max(changed) <= MOST_ROWS


async def test_a_run_is_told_to_watchers_and_to_the_audit_log(world):
    await driven_and_due(world)
    report = await retained(world, "scans=none")
    rows = world.context.transactions.read(lambda uow: uow.events.following(TENANT, "town", 0, 1000)).result()
    told = world.context.transactions.read(lambda uow: events_of(uow, rows)).result()
    assert [event.retention for event in told if event.kind is EventKind.RETENTION] == [report]
    audited = await world.use_cases.audit.newest(2)
    assert [(row.actor, row.action, row.subject) for row in audited] == [
        ("operator", "retention_set", "maps/town"),
        ("retention", "retention_applied", "maps/town"),
    ]
    assert [one["scans"] for one in audited[1].detail["rules"]] == [one.scans for one in report.rules] == [SCANS]
    assert (await world.use_cases.audit.verify()).fault is None


@pytest.mark.parametrize("policy", ["scans=none", "scans=24h,rejected=1d", "sessions=1d", "dropped=1d"])
async def test_a_dry_run_tells_what_a_run_removes(world, policy):
    await driven_and_due(world)
    asked = await world.use_cases.retention.preview(TENANT, SESSION.map_id, parsed(policy))
    before = stored_seqs(world)
    assert before and before == stored_seqs(world), "a dry run removes nothing"
    done = await retained(world, policy)
    await world.context.erasure.all()
    counted = {one.rule: (one.scans, one.loop_closures, one.sessions) for one in asked.rules}
    if policy == "dropped=1d":
        assert counted[RetentionRule.SESSIONS] == (SCANS, 0, 1) and stored_seqs(world) == []
        return
    assert counted == {one.rule: (one.scans, one.loop_closures, one.sessions) for one in done.rules}
    assert weight(asked) == weight(done) > 0


def weight(report: RetentionReport) -> int:
    return sum(one.bytes for one in report.rules)


async def test_a_dry_run_counts_content_that_another_map_names_as_kept(world):
    await driven_and_due(world)
    await driven(world, SCANS, SessionKey("village", "monday"))
    report = await world.use_cases.retention.preview(TENANT, SESSION.map_id, parsed("scans=none"))
    done = await retained(world, "scans=none")
    assert weight(report) == weight(done) < SCANS * 1000
    assert blobs_of(world, "cloud") == SCANS


async def test_the_blobs_of_a_run_are_off_the_disk(world):
    await driven_and_due(world)
    before = disk_bytes(world.home / "blobs" / TENANT / "cloud")
    (scans,) = (await retained(world, "scans=none")).rules
    assert before > 0 and disk_bytes(world.home / "blobs" / TENANT / "cloud") == 0
    assert scans.bytes == before + SCANS * SCAN_ROW_BYTES
