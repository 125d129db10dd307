"""Every store that keeps rows, one after another."""

from __future__ import annotations

import pytest

from revisit.service.engines.local.sqlite.transactions import SqliteTransactions
from revisit.service.engines.postgres.transactions import PostgresTransactions
from tests.support.made_database import made_database
from tests.support.memory.transactions import MemoryTransactions
from tests.support.plain_engine import PlainTransactions
from tests.support.stepped_clock import SteppedClock


@pytest.fixture
def clock():
    """The clock of the store."""
    return SteppedClock("boot", 0)


@pytest.fixture(params=["memory", "sqlite", "plain", "postgres"])
def transactions(request, tmp_path, clock):
    if request.param == "memory":
        yield MemoryTransactions(10_000, clock)
        return
    if request.param == "plain":
        store = PlainTransactions(10_000, clock)
        yield store
        store.close()
        return
    if request.param == "postgres":
        url, now_ms = request.getfixturevalue("postgres_url"), lambda _: clock.ms
        store = PostgresTransactions(url, lease_ms=10_000, clock=clock, now_ms=now_ms)
        yield store
        store.close()
        return
    store = SqliteTransactions(made_database(tmp_path / "test.db"), checkpoints=True, lease_ms=10_000, clock=clock)
    yield store
    store.close()


@pytest.fixture
def write(transactions):
    return lambda work: transactions.write(work).result()


@pytest.fixture
def read(transactions):
    return lambda work: transactions.read(work).result()
