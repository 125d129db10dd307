"""Group commit: writes that wait share one transaction and one sync, and stay independent of each other."""

from __future__ import annotations

import sqlite3
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from sqlalchemy.exc import OperationalError

from revisit.service.domain.errors import AlreadyExists, StorageFull
from revisit.service.engines import group_commit
from revisit.service.engines.local.sqlite.transactions import SqliteTransactions, WriterLock
from tests.support.made_database import made_database
from tests.support.patience import PATIENCE_S
from tests.support.records import TENANT, a_map

LONG_S = 60.0


@pytest.fixture
def store(tmp_path, monkeypatch):
    """A store whose groups are closed by what waits alone, so that a slow machine does not part them."""
    monkeypatch.setattr(group_commit, "MAX_GROUP_S", LONG_S)
    made_database(tmp_path / "test.db")
    opened = SqliteTransactions(tmp_path / "test.db", checkpoints=True)
    yield opened
    opened.close()


@pytest.fixture
def commits(store, monkeypatch):
    """How many transactions were committed so far."""
    count = []
    real = SqliteTransactions._transaction
    monkeypatch.setattr(store._writing, "_transaction", lambda: count.append(1) or real(store))
    return count


def add(map_id: str):
    return lambda uow: uow.maps.add(a_map(map_id))


def names(store) -> list[str]:
    return [record.map_id for record in store.read(lambda uow: uow.maps.find(TENANT)).result()]


class Held:
    """A write that holds the writer until it is let go, so that what follows has to wait, and is another group."""

    def __init__(self, store) -> None:
        self._entered, self._leave = threading.Event(), threading.Event()
        self.future = store.write(self._wait)
        self.future.add_done_callback(lambda _: setattr(group_commit, "MAX_GROUP_S", LONG_S))
        assert self._entered.wait(PATIENCE_S)

    def _wait(self, uow) -> None:
        self._entered.set()
        assert self._leave.wait(PATIENCE_S)
        group_commit.MAX_GROUP_S = 0.0  # of this group, until it is committed

    def release(self) -> None:
        self._leave.set()
        self.future.result(PATIENCE_S)


def test_what_waits_is_committed_together_in_the_order_in_which_it_came(store, commits):
    held = Held(store)
    waiting = [store.write(add(f"m{number:02}")) for number in range(20)]
    held.release()
    numbers = [future.result(PATIENCE_S).number for future in waiting]
    assert numbers == sorted(numbers)
    assert len(commits) <= 1 + 4  # 20 rows take well below 20 ms of work
    assert names(store) == [f"m{number:02}" for number in range(20)]


def test_one_that_fails_undoes_its_own_changes_only(store):
    held = Held(store)

    def half_way(uow):
        uow.maps.add(a_map("undone"))
        raise RuntimeError("half way")

    first, bad, twice, last = (store.write(work) for work in (add("a"), half_way, add("a"), add("b")))
    held.release()
    assert first.result(PATIENCE_S).map_id == "a" and last.result(PATIENCE_S).map_id == "b"
    with pytest.raises(RuntimeError, match="half way"):
        bad.result(PATIENCE_S)
    with pytest.raises(AlreadyExists):
        twice.result(PATIENCE_S)
    assert names(store) == ["a", "b"]


def test_nobody_is_answered_before_the_commit_and_all_are_told_when_it_fails(store):
    held = Held(store)

    def breaks(uow):
        error = sqlite3.OperationalError("database or disk is full")
        error.sqlite_errorname = "SQLITE_FULL"
        raise OperationalError("INSERT", {}, error)

    before, conflicting, broken = store.write(add("a")), store.write(add("a")), store.write(breaks)
    held.release()
    for future in (before, conflicting, broken):
        with pytest.raises(StorageFull):
            future.result(PATIENCE_S)
    assert names(store) == []
    assert store.write(add("a")).result(PATIENCE_S).map_id == "a"


def test_a_closed_store_finishes_what_is_queued_and_takes_nothing_more(tmp_path):
    made_database(tmp_path / "closing.db")
    store = SqliteTransactions(tmp_path / "closing.db", checkpoints=True)
    queued = [store.write(add(f"m{number}")) for number in range(100)]
    store.close()
    assert all(future.done() and future.exception() is None for future in queued)
    with pytest.raises(RuntimeError, match="closed"):
        store.write(add("late"))


def test_sixteen_clients_share_syncs(store, commits):
    def client(number):
        for turn in range(10):
            store.write(add(f"m{number}-{turn}")).result(PATIENCE_S)

    with ThreadPoolExecutor(16) as pool:
        list(pool.map(client, range(16)))
    assert len(names(store)) == 160
    assert len(commits) <= 80


def test_whoever_waits_for_the_writers_lock_gets_it_next(tmp_path):
    busy, waiting = WriterLock(tmp_path / "test.db"), WriterLock(tmp_path / "test.db")
    turns, before, stop = [], threading.Event(), threading.Event()

    def keep_busy():
        while not stop.is_set() and len(turns) < 2000:
            with busy.held():
                turns.append(1)
                before.set()
                time.sleep(0.003)

    with ThreadPoolExecutor(1) as pool:
        pool.submit(keep_busy)
        assert before.wait(PATIENCE_S)
        missed = []
        for _ in range(20):
            seen = len(turns)
            with waiting.held():
                missed.append(len(turns) - seen)
        stop.set()
    # The turn under way, and one that began while this one came to stand in the line.
    assert max(missed) <= 2
    busy.close()
    waiting.close()
