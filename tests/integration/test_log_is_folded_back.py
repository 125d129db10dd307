"""The write-ahead log stays short, whoever writes it: in an idle service with its workers, and in one that drains."""

from __future__ import annotations

import sqlite3
from contextlib import closing

import pytest

from revisit.service.domain.errors import StorageUncertain
from revisit.service.engines.local.files.disk import FailStop
from revisit.service.engines.local.sqlite import checkpoints
from revisit.service.engines.local.sqlite.checkpoints import LARGE_BYTES, OLD_S, Checkpoints
from revisit.service.engines.local.sqlite.connections import write_ahead_log
from revisit.service.engines.local.sqlite.examination import examine
from revisit.service.engines.local.sqlite.transactions import SqliteTransactions, StorageFailures
from revisit.service.features.upkeep.calls import LOG_ALARM_BYTES
from tests.support.made_database import made_database
from tests.support.patience import eventually
from tests.support.processes import ForkedService


class World:
    """A database, the transactions of a worker, which folds nothing back, and a clock that moves when told to."""

    def __init__(self, database):
        made_database(database)
        self.log, self.now_s = write_ahead_log(database), 0.0
        self.worker = SqliteTransactions(database, checkpoints=False)
        self.failed = []
        failures = StorageFailures(self.log, FailStop(lambda: self.failed.append(True)), lambda: None)
        self.checkpoints = Checkpoints(database, failures, lambda: self.now_s)

    def beat(self, bytes_more):
        """Work of a worker until so many bytes more have been written."""
        written, sent = 0, "v" * 100_000
        while written < bytes_more:
            self.worker.write(lambda uow: uow.workers.beat("w", sent)).result()
            written += len(sent)

    @property
    def size_bytes(self):
        return self.log.stat().st_size if self.log.exists() else 0


@pytest.fixture
def world(tmp_path):
    made = World(tmp_path / "home/revisit.db")
    yield made
    made.worker.close()


def test_a_log_that_only_workers_write_stays_short(world):
    sizes = []
    for _ in range(12):
        world.beat(LARGE_BYTES // 4)
        world.checkpoints.tend()
        sizes.append(world.size_bytes)
    assert max(sizes) < 1.5 * LARGE_BYTES


def test_a_file_that_has_become_long_is_not_folded_back_again_and_again(world, monkeypatch):
    world.beat(LARGE_BYTES // 4)  # a row is written twice, with its checksum
    folded, fold_back = [], world.checkpoints._fold_back
    monkeypatch.setattr(world.checkpoints, "_fold_back", lambda mode: (folded.append(mode), fold_back(mode)))
    for _ in range(90):
        world.now_s += 1.0
        world.checkpoints.tend()
        world.beat(1)
    assert folded == ["PASSIVE"] * 3
    assert world.size_bytes < LARGE_BYTES


def test_a_small_log_is_folded_back_after_a_while(world, tmp_path):
    database = tmp_path / "home/revisit.db"
    world.beat(1)
    before = database.read_bytes()
    world.checkpoints.tend()
    assert database.read_bytes() == before
    world.now_s += OLD_S
    world.checkpoints.tend()
    assert database.read_bytes() != before


def test_a_log_that_a_reader_kept_from_being_folded_back_is_cut_once_the_reader_is_gone(world, tmp_path):
    with closing(sqlite3.connect(tmp_path / "home/revisit.db")) as reader:
        reader.execute("BEGIN")
        reader.execute("SELECT * FROM workers").fetchall()
        while world.size_bytes <= LARGE_BYTES:
            world.beat(LARGE_BYTES // 2)
            world.checkpoints.tend()
    world.checkpoints.tend()
    assert world.size_bytes == 0


def test_a_disk_that_fails_while_the_log_is_folded_back_stops_the_service(world, monkeypatch):
    def fail(*_, **__):
        error = sqlite3.OperationalError("disk I/O error")
        error.sqlite_errorname = "SQLITE_IOERR_FSYNC"
        raise error

    world.beat(LARGE_BYTES + 1)
    monkeypatch.setattr(checkpoints.sqlite3, "connect", fail)
    with pytest.raises(StorageUncertain):
        world.checkpoints.tend()
    assert world.failed == [True]


def test_a_service_folds_back_what_was_left_while_it_is_idle_and_while_it_drains(world, tmp_path):
    world.beat(LOG_ALARM_BYTES + 2**20)
    with closing(ForkedService(tmp_path / "home", workers=1, fake_delay_s=3)) as service:
        eventually(lambda: world.size_bytes < LOG_ALARM_BYTES, "the log stays large")
        assert all(finding.ok is not False for finding in examine(tmp_path / "home", full=False))
        world.beat(LOG_ALARM_BYTES + 2**20)
        service.terminate()
        assert world.size_bytes < LOG_ALARM_BYTES
