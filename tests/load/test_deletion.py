"""How long the deletion of one large session keeps the writers' lock, at most.

REVISIT_DELETED_SCANS (1000000): scans of the session, each with a cloud of its own that is not on the disk. The
promise, 100 ms, is judged where REVISIT_TEST_TIMES says that the machine does nothing else; what the writer's thread
worked for it, which others do not lengthen, is judged everywhere.
"""

from __future__ import annotations

import asyncio
import os
import sqlite3
import time
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from revisit.service.domain.errors import NotFound
from revisit.service.engines.group_commit import GroupCommitter
from revisit.service.engines.local.sqlite.transactions import SqliteTransactions
from tests.support.figures import publish
from tests.support.load import quantile
from tests.support.patience import in_time
from tests.support.service_world import SESSION, TENANT, open_session, sqlite_world

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]

SCANS = int(os.environ.get("REVISIT_DELETED_SCANS", "1000000"))
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


async def test_no_transaction_of_a_deletion_keeps_the_writers_lock_for_long(tmp_path, monkeypatch):
    held_s: list[float] = []
    worked_s: list[float] = []
    transaction = SqliteTransactions._transaction

    @contextmanager
    def timed(self):
        began_s, began_cpu_s = time.perf_counter(), time.thread_time()
        with transaction(self) as connection:
            yield connection
        held_s.append(time.perf_counter() - began_s)
        worked_s.append(time.thread_time() - began_cpu_s)

    monkeypatch.setattr(SqliteTransactions, "_transaction", timed)
    world = sqlite_world(tmp_path)
    assert isinstance(world.context.transactions._writing, GroupCommitter)
    await open_session(world)
    fill(tmp_path / "revisit.db")
    held_s.clear()
    worked_s.clear()
    began_s = time.perf_counter()
    await world.use_cases.sessions.delete(TENANT, SESSION)
    with pytest.raises(NotFound):
        await world.use_cases.sessions.get(TENANT, SESSION)
    await asyncio.wait_for(world.context.erasure.all(), 3000)
    took_s = time.perf_counter() - began_s
    left = world.context.transactions.read(lambda uow: uow.everything.scans.count(TENANT)).result()
    world.context.transactions.close()
    publish(
        "deletion",
        scans=SCANS,
        transactions=len(held_s),
        took_s=round(took_s, 1),
        held_ms={share: quantile(share, [1e3 * one for one in held_s]) for share in (0.5, 0.99, 1.0)},
        worked_ms={share: quantile(share, [1e3 * one for one in worked_s]) for share in (0.5, 0.99, 1.0)},
    )
    assert left == 0
    assert max(worked_s) <= MOST_S
    assert in_time(max(held_s), MOST_S)
