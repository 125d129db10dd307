"""How long the deletion of one large session keeps the writers' lock, or rows of a server, at most.

REVISIT_DELETED_SCANS (1000000): scans of the session, each with a cloud of its own that is not on the disk;
REVISIT_DELETED_SUBMAPS (10000): submaps with descriptors, a job and three loops each. The promise, 100 ms, is judged
where REVISIT_TEST_TIMES says that the machine does nothing else; the work of the writer's thread for it, which others
do not lengthen, is judged everywhere.
"""

from __future__ import annotations

import asyncio
import os
import sqlite3
import time
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from revisit.service.domain.errors import NotFound
from revisit.service.engines.group_commit import GroupCommitter
from revisit.service.engines.local.sqlite.transactions import SqliteTransactions
from revisit.service.engines.postgres.transactions import PostgresTransactions
from tests.support.figures import publish
from tests.support.load import quantile
from tests.support.patience import in_time
from tests.support.records import a_job, a_loop, a_submap
from tests.support.service_world import SESSION, TENANT, open_session, postgres_world, sqlite_world

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]

SCANS = int(os.environ.get("REVISIT_DELETED_SCANS", "1000000"))
SUBMAPS = int(os.environ.get("REVISIT_DELETED_SUBMAPS", "10000"))
PORTION = 500
MOST_S = 0.1
COPIES = """
    WITH RECURSIVE seqs(seq) AS (SELECT 1 UNION ALL SELECT seq + 1 FROM seqs WHERE seq < ?)
    INSERT INTO scans (tenant, map_id, session_id, seq, stamp_ns, T_odom_sensor, travelled_m, point_count, cloud_sha256)
    SELECT ?, ?, ?, seq, seq, '[1.0,0.0,0.0,0.5,0.0,1.0,0.0,0.25,0.0,0.0,1.0,0.0,0.0,0.0,0.0,1.0]', seq * 0.15, 40000,
    lower(hex(randomblob(32))) FROM seqs
"""


def fill(database: Path) -> None:
    with closing(sqlite3.connect(database)) as connection:
        connection.execute(COPIES, (SCANS, TENANT, SESSION.map_id, SESSION.session_id))
        connection.commit()
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")


def fill_with_submaps(world) -> None:
    """Described submaps of the session with their jobs and loops, in portions."""
    for first in range(0, SUBMAPS, PORTION):
        world.context.transactions.write(partial(_add_submaps, ordinals=range(first, first + PORTION))).result()


def _add_submaps(uow, ordinals) -> None:
    descriptor = np.full(1024, 1 / 32, dtype="<f4").tobytes()
    town = uow.maps.get(TENANT, SESSION.map_id)
    session = uow.sessions.get(TENANT, SESSION.map_id, SESSION.session_id)
    for ordinal in ordinals:
        operation = f"op-{ordinal}"
        named = {"session_id": SESSION.session_id, "session_number": session.number, "operation_id": operation}
        described = {"state": "DESCRIBED", "descriptor": descriptor, "cloud_sha256": None, **named}
        number = uow.submaps.add(a_submap(f"s{ordinal}", ordinal, TENANT, **described)).number
        uow.jobs.add(a_job(operation, TENANT, state="SUCCEEDED"))
        uow.changes.record_described(town, number)
        before = range(max(number - 3, 1), number) if ordinal > 3 else ()
        uow.loops.add_all([replace(a_loop(number, match), tenant=TENANT) for match in before])


@contextmanager
def transactions_timed(monkeypatch, kind):
    """How long each transaction was open, and how long its thread worked, in seconds."""
    held_s: list[float] = []
    worked_s: list[float] = []
    transaction = kind._transaction

    @contextmanager
    def timed(self):
        began_s, began_cpu_s = time.perf_counter(), time.thread_time()
        with transaction(self) as connection:
            yield connection
        held_s.append(time.perf_counter() - began_s)
        worked_s.append(time.thread_time() - began_cpu_s)

    with monkeypatch.context() as patch:
        patch.setattr(kind, "_transaction", timed)
        yield held_s, worked_s


async def erased(world) -> float:
    """Delete the session; the seconds until nothing is left of it."""
    began_s = time.perf_counter()
    await world.use_cases.sessions.delete(TENANT, SESSION)
    with pytest.raises(NotFound):
        await world.use_cases.sessions.get(TENANT, SESSION)
    await asyncio.wait_for(world.context.erasure.all(), 3000)
    return time.perf_counter() - began_s


def judged(name: str, took_s: float, held_s: list[float], worked_s: list[float], **sizes: int) -> None:
    """State the figures and hold them against the promise."""
    shares = (0.5, 0.99, 1.0)
    publish(
        name,
        **sizes,
        transactions=len(held_s),
        took_s=round(took_s, 1),
        held_ms={share: quantile(share, [1e3 * one for one in held_s]) for share in shares},
        worked_ms={share: quantile(share, [1e3 * one for one in worked_s]) for share in shares},
    )
    assert max(worked_s) <= MOST_S
    assert in_time(max(held_s), MOST_S)


async def test_no_transaction_of_a_deletion_keeps_the_writers_lock_for_long(tmp_path, monkeypatch):
    with transactions_timed(monkeypatch, SqliteTransactions) as (held_s, worked_s):
        world = sqlite_world(tmp_path)
        assert isinstance(world.context.transactions._writing, GroupCommitter)
        await open_session(world)
        fill(tmp_path / "revisit.db")
        held_s.clear()
        worked_s.clear()
        took_s = await erased(world)
    left = world.context.transactions.read(lambda uow: uow.everything.scans.count(TENANT)).result()
    world.context.transactions.close()
    assert left == 0
    judged("deletion", took_s, held_s, worked_s, scans=SCANS)


@pytest.mark.parametrize("engine", ["sqlite", "postgres"])
async def test_no_transaction_of_the_deletion_of_many_submaps_holds_rows_for_long(tmp_path, monkeypatch, engine):
    kind = SqliteTransactions if engine == "sqlite" else PostgresTransactions
    with transactions_timed(monkeypatch, kind) as (held_s, worked_s):
        world = sqlite_world(tmp_path) if engine == "sqlite" else postgres_world()
        await open_session(world)
        fill_with_submaps(world)
        held_s.clear()
        worked_s.clear()
        took_s = await erased(world)
    left = world.context.transactions.read(
        lambda uow: (uow.everything.submaps.count(TENANT), uow.everything.loops.count(TENANT))
    ).result()
    world.context.transactions.close()
    assert left == (0, 0)
    judged(f"deletion of submaps, {engine}", took_s, held_s, worked_s, submaps=SUBMAPS)
