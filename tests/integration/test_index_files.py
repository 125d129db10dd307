"""The file of a map's index is used where it is right, made again where it is not, and never answered from wrongly."""

from __future__ import annotations

import asyncio
import errno
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from revisit.core.index import FaissIndex, rows
from revisit.service.engines.local.files import index_files
from revisit.service.engines.local.files.index_files import IndexFiles
from revisit.service.engines.local.vector_index import PlaceVectorIndex
from revisit.service.features.index.caught_up_index import CaughtUpIndex
from revisit.service.features.index.keeping import IndexHealth
from revisit.service.ports.disk import UnlimitedDisk
from revisit.service.use_cases import UseCases
from tests.support.own_index import memory_over
from tests.support.records import anywhere
from tests.support.service_world import SESSION, TENANT, described_home, sqlite_world, submap

SUBMAPS = 12
EVERY_ONE = [f"s{number}" for number in range(SUBMAPS)]


class Process:
    """A process of the service over the data in `home`; the gateway writes the files."""

    def __init__(self, home: Path, *, gateway: bool = True) -> None:
        self.home = home
        self.world = sqlite_world(home)
        index = PlaceVectorIndex(FaissIndex, IndexFiles(home / "index"), saved_from=1 if gateway else None)
        self.context = replace(self.world.context, index=index, index_health=IndexHealth())
        self.use_cases = UseCases.over(self.context, "test")
        self.keeper = self.context.index_keeper() if gateway else None
        if self.keeper is not None:
            asyncio.run(self.keeper.load())

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *_: object) -> None:
        self.context.transactions.close()

    @property
    def map(self):
        return self.context.transactions.read(lambda uow: uow.maps.get(TENANT, SESSION.map_id)).result()

    @property
    def own_rows(self) -> int:
        """Descriptors in the process's own memory."""
        return self.context.index._maps[self.map.number].entries.own_rows

    def saved(self) -> int:
        """How many files its keeper writes."""
        return asyncio.run(self.keeper.tend_files())

    def found(self) -> list[str]:
        """The submap that a search for each finds first."""
        memory = memory_over(self.context.transactions, self.context.index)
        rows = self.context.transactions.read(lambda uow: uow.submaps.find(TENANT, map_id=SESSION.map_id)).result()
        vectors = [np.frombuffer(row.descriptor, dtype="<f4") for row in rows]
        return [memory.recall(self.map, vector, 1, anywhere).places[0].submap.submap_id for vector in vectors]

    def delete(self, submap_id: str) -> None:
        asyncio.run(self.use_cases.submaps.delete(TENANT, submap(submap_id, 0).key))

    def row(self, submap_id: str):
        key = SESSION.map_id, SESSION.session_id, submap_id
        return self.context.transactions.read(lambda uow: uow.submaps.get(TENANT, *key)).result()

    def descriptor(self, submap_id: str) -> bytes:
        """As the index holds it."""
        rows = self.context.index._maps[self.map.number].entries._rows
        return rows.vectors.as_held(rows.row_of[self.row(submap_id).number]).tobytes()


def files(home: Path) -> list[Path]:
    return sorted((home / "index").iterdir()) if (home / "index").is_dir() else []


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """The data of a service with submaps, and the file of their index."""
    home = described_home(tmp_path_factory.mktemp("filled"), SUBMAPS)
    with Process(home) as gateway:
        assert gateway.saved() == 1
    return home


@pytest.fixture
def home(tmp_path, filled) -> Path:
    return shutil.copytree(filled, tmp_path, dirs_exist_ok=True)


def test_other_processes_take_what_one_has_saved_and_keep_no_descriptor_themselves(home):
    with Process(home) as gateway, Process(home, gateway=False) as worker:
        assert gateway.found() == worker.found() == EVERY_ONE
        assert (gateway.own_rows, worker.own_rows) == (0, 0)
        assert gateway.saved() == 0
        assert [path.name for path in files(home)] == [gateway.map.index_file.partition("-")[0]]
        assert files(home)[0].stat().st_mode & 0o777 == 0o600


DAMAGES = {
    "gone": lambda path: path.unlink(),
    "empty": lambda path: path.write_bytes(b""),
    "of another index": lambda path: path.write_bytes(bytes(path.stat().st_size)),
    "without its end": lambda path: os.truncate(path, path.stat().st_size - 1),
    "half": lambda path: os.truncate(path, path.stat().st_size // 2),
    "longer": lambda path: path.write_bytes(path.read_bytes() + b"\0"),
    "without its beginning": lambda path: path.write_bytes(path.read_bytes()[64:]),
}


def with_a_bit_flipped(path: Path, at: int) -> None:
    content = bytearray(path.read_bytes())
    content[at] ^= 1 << (at % 8)
    path.write_bytes(content)


def with_a_descriptor_lost(path: Path) -> None:
    """As after a power cut: a page that was not written is zeros."""
    content = bytearray(path.read_bytes())
    content[4 * 64 * 3 : 4 * 64 * 4] = bytes(4 * 64)
    path.write_bytes(content)


DAMAGES |= {"with a descriptor lost": with_a_descriptor_lost} | {
    f"with a bit flipped at {share}": lambda path, share=share: with_a_bit_flipped(
        path, int(share * path.stat().st_size)
    )
    for share in (0.1, 0.3, 0.5, 0.7, 0.9, 0.99)
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_made_again_and_changes_no_answer(home, damage):
    DAMAGES[damage](files(home)[0])
    with Process(home, gateway=False) as worker:
        assert worker.found() == EVERY_ONE
        assert worker.own_rows == SUBMAPS
    with Process(home) as gateway:
        assert gateway.found() == EVERY_ONE
        assert gateway.saved() == 1
        assert (len(files(home)), gateway.own_rows) == (1, 0)
        assert gateway.found() == EVERY_ONE


def test_a_bit_that_flips_in_the_file_while_it_is_used_is_drift(home):
    with Process(home) as gateway:
        assert asyncio.run(gateway.keeper.audit()) == 0
        with files(home)[0].open("r+b") as file:
            file.seek(4 * 64 * 5)
            byte = file.read(1)[0]
            file.seek(-1, os.SEEK_CUR)
            file.write(bytes([byte ^ 4]))
        assert [asyncio.run(gateway.keeper.audit()) for _ in range(2)] == [1, 0]
        assert gateway.found() == EVERY_ONE
        assert gateway.saved() == 1


def test_a_file_of_a_later_state_is_not_used_beside_an_older_database(home):
    older = (home / "revisit.db").read_bytes()
    with Process(home) as gateway:
        gateway.delete("s0")
        asyncio.run(gateway.use_cases.posting.post(TENANT, submap("later", 40)))
        gateway.world.work_off()
        assert gateway.saved() == 0 or gateway.found()
        gateway.context.index._saved_from = 1
        gateway.context.index._maps[gateway.map.number].file = None
        gateway.saved()
    (home / "revisit.db").write_bytes(older)
    with Process(home) as gateway:
        asyncio.run(gateway.use_cases.posting.post(TENANT, submap("other", 41)))  # takes the numbers of "later"
        gateway.world.work_off()
        assert gateway.found() == [*EVERY_ONE, "other"]


def test_what_was_erased_from_a_file_is_found_again_once_its_database_is_restored(home):
    older = (home / "revisit.db").read_bytes()
    with Process(home) as gateway:
        gateway.delete("s4")
        gateway.saved()
        assert gateway.found() == [name for name in EVERY_ONE if name != "s4"]
    (home / "revisit.db").write_bytes(older)
    with Process(home) as gateway:
        assert gateway.found() == EVERY_ONE


def test_a_deleted_submap_leaves_the_file_and_a_deleted_map_takes_it_along(home):
    with Process(home) as gateway, Process(home, gateway=False) as worker:
        descriptor, kept = gateway.descriptor("s4"), gateway.descriptor("s5")
        position = np.array(gateway.row("s4").position_m).tobytes()
        assert worker.found() == EVERY_ONE
        assert all(trace in files(home)[0].read_bytes() for trace in (descriptor, position))
        gateway.delete("s4")
        gateway.saved()
        content = files(home)[0].read_bytes()
        assert (descriptor in content, kept in content) == (False, True)
        assert worker.found() == gateway.found() == [name for name in EVERY_ONE if name != "s4"]
        gateway.context.index._traces_kept_s = 0.0
        assert gateway.saved() == 1
        assert position not in files(home)[0].read_bytes()
        asyncio.run(gateway.use_cases.maps.delete(TENANT, SESSION.map_id))
        assert files(home) == []


def test_what_is_deleted_leaves_the_file_of_a_map_too_that_has_become_small(home, monkeypatch):
    monkeypatch.setattr(rows, "SMALLEST_TO_COMPACT", 1)
    with Process(home) as gateway:
        gateway.context.index._saved_from = SUBMAPS
        for name in EVERY_ONE[:7]:
            gateway.delete(name)
        assert gateway.saved() == 0
        descriptor, position = gateway.descriptor("s7"), np.array(gateway.row("s7").position_m).tobytes()
        assert descriptor in files(home)[0].read_bytes()
        gateway.delete("s7")
        assert gateway.saved() == 0
        assert descriptor not in files(home)[0].read_bytes()
        assert position in files(home)[0].read_bytes()
        gateway.context.index._traces_kept_s = 0.0
        assert gateway.saved() == 1
        assert position not in files(home)[0].read_bytes()
        assert gateway.found() == EVERY_ONE[8:]


def test_a_search_whose_hit_is_erased_meanwhile_loads_the_file_again(home, monkeypatch):
    with Process(home) as gateway, Process(home, gateway=False) as worker:
        assert worker.found() == EVERY_ONE
        search = worker.context.index.search

        def after_the_deletion(*arguments):
            monkeypatch.undo()
            gateway.delete("s0")
            gateway.saved()
            return search(*arguments)

        vector = np.frombuffer(worker.row("s0").descriptor, dtype="<f4")
        monkeypatch.setattr(worker.context.index, "search", after_the_deletion)
        memory = memory_over(worker.context.transactions, worker.context.index)
        names = {place.submap.submap_id for place in memory.recall(worker.map, vector, 20, anywhere).places}
        assert names == set(EVERY_ONE) - {"s0"}
        assert worker.own_rows == 0


def test_a_file_that_is_replaced_is_let_go_with_the_next_deletion(home):
    with Process(home) as gateway, Process(home, gateway=False) as worker:
        assert worker.found() == EVERY_ONE
        old = gateway.map.index_file
        gateway.context.index.drop(gateway.map.number)
        assert gateway.saved() == 0
        CaughtUpIndex(gateway.context.transactions, gateway.context.index).catch_up(TENANT, gateway.map.number)
        assert gateway.saved() == 1
        gateway.delete("s4")
        assert worker.found() == [name for name in EVERY_ONE if name != "s4"]
        assert worker.context.index._maps[worker.map.number].file == gateway.map.index_file != old


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, errno.EDQUOT])
def test_without_room_for_a_file_everything_else_goes_on(home, monkeypatch, number):
    files(home)[0].unlink()

    def fails(path, pieces):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(index_files, "replaceable_write", fails)
    with Process(home) as gateway:
        assert gateway.saved() == 0
        assert (gateway.found(), files(home)) == (EVERY_ONE, [])


def test_no_file_is_written_on_a_full_disk(home):
    class Full(UnlimitedDisk):
        def full(self) -> bool:
            return True

    files(home)[0].unlink()
    with Process(home) as gateway:
        gateway.keeper._disk = Full()
        assert (gateway.saved(), files(home)) == (0, [])


def test_files_that_no_map_names_are_deleted_at_the_start(home):
    (home / "index" / "0123456789abcdef").write_bytes(b"of a map that was deleted while nobody looked")
    (home / "index" / ".half-written").write_bytes(b"left by a kill")
    with Process(home) as gateway:
        assert [path.name for path in files(home)] == [gateway.map.index_file.partition("-")[0]]
