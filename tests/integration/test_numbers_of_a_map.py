"""Numbers of a map are in the order of the commits: a reader that goes on behind the last one misses none."""

from __future__ import annotations

import threading
from functools import partial

import pytest

from revisit.service.domain.events import EventRecord
from revisit.service.domain.identity import TenantId
from revisit.service.engines.local.sqlite.transactions import SqliteTransactions
from revisit.service.engines.postgres.transactions import PostgresTransactions
from tests.support.campaigns import sizes
from tests.support.made_database import made_database
from tests.support.records import TENANT, a_map, a_session, a_submap
from tests.support.stepped_clock import SteppedClock

WRITERS = 8
MAPS = (("town", TENANT), ("yard", TENANT), ("town", TenantId("other")))


@pytest.fixture(params=["sqlite", "postgres"])
def stores(request, tmp_path):
    """A store for each writer, as processes have them, and one for the reader; three maps."""
    if request.param == "postgres":
        url = request.getfixturevalue("postgres_url")
        made = [PostgresTransactions(url, clock=SteppedClock()) for _ in range(WRITERS + 1)]
    else:
        database = made_database(tmp_path / "test.db")
        made = [SqliteTransactions(database, checkpoints=not at) for at in range(WRITERS + 1)]
    for of in MAPS:
        made[0].write(
            lambda uow, of=of: (uow.maps.add(a_map(*of)), uow.sessions.add(a_session("monday", *of)))
        ).result()
    yield made
    for store in made:
        store.close()


def happen(uow, writer, number):
    """Events in all maps, a submap and a change in one: as many writers want the same counters."""
    for map_id, tenant in (MAPS, MAPS[::-1])[writer % 2]:
        uow.events.record(EventRecord(tenant, map_id, "OPERATION", f"{writer}-{number}"))
    added = uow.submaps.add(a_submap(f"{writer}-{number}", ordinal=1000 * writer + number))
    uow.changes.record_described(uow.maps.get(TENANT, "town"), added.number)


class Reader:
    """Reads the events of a map from behind the last that it has seen."""

    def __init__(self, store, map_id, tenant) -> None:
        self._store, self._of = store, (tenant, map_id)
        self.seen: list[EventRecord] = []

    def read(self) -> None:
        last = self.seen[-1].number if self.seen else 0
        self.seen += self._store.read_here(lambda uow: uow.events.following(*self._of, last, 50))


@pytest.mark.parametrize("events", sizes("EVENTS", 400, 10_000))
@pytest.mark.timeout(3600)
def test_a_reader_beside_eight_writers_misses_no_event_and_gets_none_twice(stores, events):
    each = events // WRITERS

    def write(writer: int) -> None:
        for number in range(each):
            stores[writer].write(partial(happen, writer=writer, number=number)).result()

    readers = [Reader(stores[-1], *of) for of in MAPS]
    writers = [threading.Thread(target=write, args=(writer,)) for writer in range(WRITERS)]
    for one in writers:
        one.start()
    while any(one.is_alive() for one in writers) or any(len(one.seen) < each * WRITERS for one in readers):
        before = sum(len(one.seen) for one in readers)
        alive = any(one.is_alive() for one in writers)
        for reader in readers:
            reader.read()
        if not alive and sum(len(one.seen) for one in readers) == before:
            break
    expected = {f"{writer}-{number}" for writer in range(WRITERS) for number in range(each)}
    for reader in readers:
        assert [event.number for event in reader.seen] == list(range(1, each * WRITERS + 1))
        assert {event.subject for event in reader.seen} == expected
    submaps = stores[-1].read_here(lambda uow: uow.submaps.find(TENANT, map_id="town"))
    assert sorted(one.seq for one in submaps) == sorted(one.entered for one in submaps)
    assert sorted(one.seq for one in submaps) == list(range(1, each * WRITERS + 1))
