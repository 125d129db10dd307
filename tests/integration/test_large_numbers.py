"""Numbers of rows beyond 32 bits: 1,000 robots at ten scans a second are there after two and a half days."""

from __future__ import annotations

import pytest
from sqlalchemy import BigInteger, Integer, text

from revisit.service.engines.local.sqlite.transactions import SqliteTransactions
from revisit.service.engines.postgres.transactions import PostgresTransactions
from revisit.service.engines.sql.tables import metadata
from tests.support.made_database import made_database
from tests.support.records import TENANT, a_job, a_loop, a_map, a_scan, a_session, a_submap
from tests.support.stepped_clock import SteppedClock

FAR = 2**40
NUMBERED = [table for table in metadata.sorted_tables if table.primary_key.columns.keys() in (["number"], ["seq"])]


@pytest.mark.parametrize("table", metadata.sorted_tables, ids=lambda table: table.name)
def test_every_whole_number_of_a_row_has_64_bits(table):
    narrow = [c.name for c in table.columns if isinstance(c.type, Integer) and not isinstance(c.type, BigInteger)]
    assert narrow == []


@pytest.fixture(params=["sqlite", "postgres"])
def store(request, tmp_path, postgres_url):
    """A store in which every table has given out 2^40 numbers."""
    if request.param == "sqlite":
        opened = SqliteTransactions(made_database(tmp_path / "revisit.db"), checkpoints=True)
        far = "INSERT INTO sqlite_sequence (name, seq) VALUES ('{0}', {2})"
    else:
        opened = PostgresTransactions(postgres_url, clock=SteppedClock())
        far = "SELECT setval(pg_get_serial_sequence('{0}', '{1}'), {2})"
    statements = [far.format(table.name, table.primary_key.columns.keys()[0], FAR) for table in NUMBERED]
    opened.write(lambda uow: [uow.connection.execute(text(statement)) for statement in statements]).result()
    yield opened
    opened.close()


def test_rows_beyond_32_bits_are_stored_found_and_referred_to(store):
    def fill(uow):
        added = uow.maps.add(a_map())
        session = uow.sessions.add(a_session())
        uow.scans.add(a_scan())
        submaps = [uow.submaps.add(a_submap(one, n, session_number=session.number)) for n, one in enumerate("ab")]
        loop = uow.loops.add(a_loop(submaps[0].number, submaps[1].number))
        uow.changes.record_described(added, submaps[0].number)
        uow.queue.enqueue(a_job())
        uow.blobs.release(TENANT, {("cloud", "f" * 64)})
        return submaps, loop

    submaps, loop = store.write(fill).result()
    numbers = [one.number for one in submaps]
    assert min(numbers) > FAR and loop.query_number == numbers[0]

    def read(uow):
        (found,) = uow.loops.find(TENANT, query_number=numbers[0])
        known = uow.submaps.numbered(TENANT, numbers)
        later = uow.submaps.find(TENANT, after=numbers[0], limit=5)
        return found.match_number, sorted(known), [one.number for one in later], uow.changes.since(TENANT, 1, 0)

    match, known, later, _ = store.read(read).result()
    assert (match, known, later) == (numbers[1], numbers, numbers[1:])
    lease = store.write(lambda uow: uow.queue.claim("w1")).result()
    store.write(lambda uow: uow.queue.complete(lease, {})).result()
    gone = store.write(lambda uow: uow.loops.delete_some(TENANT, 5, "query_number", numbers)).result()
    assert gone == 1
