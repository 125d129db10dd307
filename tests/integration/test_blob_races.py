"""A blob that is found again while it is collected ends with its row and its bytes, whoever comes when.

REVISIT_BLOB_RACES (30): races of two processes' threads over one content.
"""

from __future__ import annotations

import asyncio
import hashlib
import itertools
import os
import random
import threading
import time
from dataclasses import replace
from functools import partial

import pytest

from revisit.service.domain.errors import BlobCollected
from revisit.service.engines.local.files.blobs import FileBlobStore
from revisit.service.engines.local.sqlite.transactions import SqliteTransactions
from revisit.service.engines.postgres.transactions import PostgresTransactions
from revisit.service.engines.sql.blob_rows import CUT_OFF_MS
from revisit.service.features.upkeep.sweeping import BLOBS_PER_TURN, collect
from revisit.service.ports.blobs import CLOUD_BLOB
from revisit.service.ports.storage import Naming, Storage, write_naming
from revisit.service.use_cases import UseCases
from tests.faults.drive import drive
from tests.faults.history import History
from tests.support.made_database import made_database
from tests.support.memory.blobs import MemoryBlobStore
from tests.support.memory.transactions import MemoryTransactions
from tests.support.plain_engine import PlainTransactions
from tests.support.records import TENANT, a_map, a_scan, a_session
from tests.support.service_world import sqlite_world
from tests.support.stepped_clock import SteppedClock

RACES = int(os.environ.get("REVISIT_BLOB_RACES", "30"))
HOUR_MS = 3_600_000
DATA = b"the same cloud once more"
BLOB = (CLOUD_BLOB, hashlib.sha256(DATA).hexdigest())
ORDERS = [
    order
    for order in set(itertools.permutations(["put", "commit", "begin", "delete", "end"]))
    if order.index("put") < order.index("commit") and order.index("begin") < order.index("delete") < order.index("end")
]


@pytest.fixture
def clock():
    """The store's."""
    return SteppedClock()


@pytest.fixture(params=["memory", "sqlite", "plain", "postgres"])
def storage(request, tmp_path, clock):
    if request.param == "memory":
        transactions, blobs = MemoryTransactions(10_000, clock), MemoryBlobStore()
    elif request.param == "plain":
        transactions, blobs = PlainTransactions(10_000, clock), MemoryBlobStore()
    elif request.param == "postgres":
        transactions = PostgresTransactions(
            request.getfixturevalue("postgres_url"), clock=clock, now_ms=lambda _: clock.ms
        )
        blobs = MemoryBlobStore()
    else:
        database = made_database(tmp_path / "revisit.db")
        transactions = SqliteTransactions(database, checkpoints=True, clock=clock)
        blobs = FileBlobStore(tmp_path / "blobs")
    yield Storage(transactions, blobs)
    transactions.close()


def with_a_released_blob(storage: Storage) -> Storage:
    """A session without scans; the bytes are there, and the last row that named them is gone."""

    def fill(uow):
        uow.maps.add(a_map())
        uow.sessions.add(a_session())
        uow.blobs.release(TENANT, {BLOB})

    storage.blobs.put(TENANT, CLOUD_BLOB, DATA)
    storage.transactions.write(fill).result()
    return storage


def name_it(uow, seq: int = 1) -> None:
    uow.blobs.refer(TENANT, [BLOB])
    uow.scans.add(replace(a_scan(seq), cloud_sha256=BLOB[1]))


def begin(uow):
    return uow.blobs.begin(0, BLOBS_PER_TURN)


def end(uow, begun):
    uow.blobs.end(begun, begun.blobs)


def is_lost(storage: Storage) -> bool:
    """Whether a row names the blob and its bytes are gone."""
    named = storage.transactions.read(lambda uow: uow.scans.count(TENANT, cloud_sha256=BLOB[1])).result()
    return bool(named) and not storage.blobs.exists(TENANT, *BLOB)


@pytest.mark.parametrize("order", sorted(ORDERS), ids="-".join)
def test_in_every_order_of_their_steps_row_and_bytes_are_there_at_the_end(storage, order):
    with_a_released_blob(storage)
    write, put = storage.transactions.write, partial(storage.blobs.put, TENANT, CLOUD_BLOB, DATA)
    naming, named = Naming(name_it), False
    for step in order:
        if step == "put":
            put()
        elif step == "begin":
            begun = write(begin).result()
        elif step == "delete":
            storage.blobs.delete(begun.blobs.values())
        elif step == "end":
            write(partial(end, begun=begun)).result()
        else:
            try:
                write(naming).result()
                named = True
            except BlobCollected as collected:
                naming = naming.after(collected)
        assert not is_lost(storage), step
    if not named:
        put()
        write_naming(storage.transactions, naming.work, put)
    assert not is_lost(storage)
    assert storage.transactions.read(lambda uow: uow.scans.count(TENANT)).result() == 1
    assert asyncio.run(collect(storage, 0.0)) == 0 and not is_lost(storage)


def test_a_writer_that_knows_of_no_other_is_refused_until_the_bytes_are_put_again(storage):
    """Two writers put before the bytes went: neither may name them on the strength of that."""
    with_a_released_blob(storage)
    assert asyncio.run(collect(storage, 0.0)) == 1
    write = storage.transactions.write
    with pytest.raises(BlobCollected) as refused:
        write(Naming(name_it)).result()
    storage.blobs.put(TENANT, CLOUD_BLOB, DATA)
    with pytest.raises(BlobCollected):
        write(Naming(name_it)).result()
    write(Naming(name_it).after(refused.value)).result()
    write(partial(name_it, seq=2)).result()
    assert not is_lost(storage)


def test_the_hour_begins_when_the_last_row_goes(storage, clock):
    with_a_released_blob(storage)
    write = storage.transactions.write
    clock.ms += HOUR_MS - 1
    assert asyncio.run(collect(storage)) == 0
    write(name_it).result()
    write(partial(name_it, seq=2)).result()
    for seq in (1, 2):
        with_one_row_less(storage, seq)
        clock.ms += HOUR_MS - 1
        assert asyncio.run(collect(storage)) == 0 and storage.blobs.exists(TENANT, *BLOB)
    clock.ms += 1
    assert asyncio.run(collect(storage)) == 1 and not storage.blobs.exists(TENANT, *BLOB)


def test_a_blob_that_another_row_names_stays_however_long_ago_one_went(storage, clock):
    with_a_released_blob(storage)
    for seq in (1, 2):
        storage.transactions.write(partial(name_it, seq=seq)).result()
    with_one_row_less(storage, 1)
    clock.ms += 2 * HOUR_MS
    assert asyncio.run(collect(storage)) == 0 and storage.blobs.exists(TENANT, *BLOB)


def test_a_collection_that_was_cut_off_is_ended_by_the_next(storage, clock):
    with_a_released_blob(storage)
    storage.transactions.write(begin).result()
    assert asyncio.run(collect(storage, 0.0)) == 0 and storage.blobs.exists(TENANT, *BLOB)
    clock.ms += CUT_OFF_MS
    assert asyncio.run(collect(storage, 0.0)) == 1 and not storage.blobs.exists(TENANT, *BLOB)


def test_a_collector_that_was_overtaken_ends_nothing(storage, clock):
    with_a_released_blob(storage)
    write = storage.transactions.write
    slow = write(begin).result()
    clock.ms += CUT_OFF_MS
    write(begin).result()
    write(partial(end, begun=slow)).result()
    with pytest.raises(BlobCollected) as refused:
        write(name_it).result()
    assert refused.value.pending and not refused.value.gone


def raced(first: Storage, second: Storage, seq: int, rng: random.Random) -> None:
    """One writer names the content while another process collects it."""
    waits = [rng.uniform(0.0, 0.004) for _ in range(3)]

    def collecting() -> None:
        time.sleep(waits[0])
        asyncio.run(collect(second, 0.0))

    collector = threading.Thread(target=collecting)
    collector.start()
    put = partial(first.blobs.put, TENANT, CLOUD_BLOB, DATA)
    time.sleep(waits[1])
    put()
    time.sleep(waits[2])
    write_naming(first.transactions, partial(name_it, seq=seq), put)
    collector.join()


@pytest.fixture(params=["sqlite", "postgres"])
def stores(request, tmp_path):
    """One store, as two processes have it open."""
    if request.param == "sqlite":
        database = made_database(tmp_path / "revisit.db")
        opened = [SqliteTransactions(database, checkpoints=first) for first in (True, False)]
    else:
        url = request.getfixturevalue("postgres_url")
        opened = [PostgresTransactions(url, clock=SteppedClock()) for _ in range(2)]
    yield [Storage(transactions, FileBlobStore(tmp_path / "blobs")) for transactions in opened]
    for transactions in opened:
        transactions.close()


def test_of_many_races_none_leaves_a_row_without_its_bytes(stores):
    with_a_released_blob(stores[0])
    rng, lost, collected = random.Random(7), 0, 0
    for race in range(1, RACES + 1):
        raced(*stores, race, rng)
        lost += is_lost(stores[0])
        with_one_row_less(stores[0], race)
        if rng.random() < 0.5:
            collected += asyncio.run(collect(stores[1], 0.0))
    assert lost == 0
    assert collected > RACES // 10


def with_one_row_less(storage: Storage, seq: int) -> None:
    def delete(uow):
        uow.scans.delete(TENANT, seq=seq)
        uow.blobs.release(TENANT, {BLOB})

    storage.transactions.write(delete).result()


class OutsideOfTransactions:
    """A blob store that no unit of work may call: it notes the names of the threads that do."""

    def __init__(self, store: MemoryBlobStore) -> None:
        self._store = store
        self.within: set[str] = set()

    def __getattr__(self, name):
        if threading.current_thread().name == "writer":
            self.within.add(name)
        return getattr(self._store, name)


async def test_no_transaction_touches_a_blob(tmp_path):
    world = sqlite_world(tmp_path)
    blobs = OutsideOfTransactions(MemoryBlobStore())
    context = replace(world.context, blobs=blobs)
    world = replace(world, context=context, use_cases=UseCases.over(context, "test"))
    try:
        await drive(world, History())
    finally:
        context.transactions.close()
    assert len(blobs._store._blobs) > 10
    assert blobs.within == set()
