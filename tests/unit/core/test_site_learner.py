"""What an index has learned is what the reference learns from the places that are left, and costs what has changed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from revisit.core.config import AdaptationConfig
from revisit.core.descriptor.adaptation import SiteStatistics
from revisit.core.errors import DataLoss
from revisit.core.index import ExactIndex, FaissIndex, IndexEntry, SearchFilter, SharedRows
from revisit.core.index.descriptors import Descriptors
from revisit.core.index.learning import learn_plainly

SIZE = 16
CONFIG = AdaptationConfig()
Array = NDArray[np.float32]


def resumed(index: FaissIndex, coded_from: int, without: str = "") -> FaissIndex:
    """What another process makes of its file; without one of its arrays."""
    stored = index.stored()
    vectors, marks = (np.concatenate(parts) for parts in zip(*stored.portions(), strict=True))
    arrays = {name: array for name, array in stored.arrays.items() if name != without}
    return FaissIndex.restored(SharedRows(stored.arrays["ids"], vectors, marks), arrays, coded_from=coded_from)


def as_bytes(site: SiteStatistics | None) -> dict[int | str, bytes] | None:
    """All of it, bit for bit."""
    if site is None:
        return None
    means = {session: mean.tobytes() for session, mean in site.session_means.items()}
    return {"mean": site.mean.tobytes(), "spread": site.spread.tobytes(), **means}


def learned(index: FaissIndex) -> dict[int | str, bytes] | None:
    """What it knows after the next search."""
    index._learn()
    return as_bytes(index._learner.site)


@dataclass
class Drives:
    """Random drives of a few sessions at a time, and what becomes of them; some stand still, some come back."""

    rng: np.random.Generator
    kept: dict[int, int] = field(default_factory=dict)
    """id -> session of the places that are left"""
    count: int = 0

    def places(self, count: int) -> tuple[list[IndexEntry], Array]:
        """New places of the sessions that drive at the moment, between each other."""
        driving = self.count // 40 + self.rng.integers(3, size=count)
        cells = self.rng.integers(max(self.count // 6, 4), size=count)
        new = [
            IndexEntry(self.count + i, int(session), self.count + i, np.array([5.0 * cell + 1.0, 0.0, 0.0]))
            for i, (session, cell) in enumerate(zip(driving, cells, strict=True))
        ]
        self.kept |= {entry.id: entry.session for entry in new}
        self.count += count
        vectors = 1.0 + 0.3 * driving[:, None] * np.linspace(-1, 1, SIZE) + self.rng.normal(size=(count, SIZE))
        return new, vectors.astype(np.float32)

    def gone(self) -> list[int]:
        """Places that are removed: a few, a session, or most of all."""
        ids, kind = list(self.kept), self.rng.integers(12)
        if kind == 0:
            chosen = self.rng.permutation(ids)[: int(0.6 * len(ids))].tolist()
        elif kind < 5 and ids:
            session = self.kept[ids[self.rng.integers(len(ids))]]
            chosen = [identifier for identifier in ids if self.kept[identifier] == session]
        else:
            chosen = self.rng.permutation(ids)[:2].tolist()
        for identifier in chosen:
            del self.kept[identifier]
        return chosen


CHANGED: dict[str, Callable[[FaissIndex, int], FaissIndex]] = {
    "goes on": lambda index, _: index,
    "from a file": resumed,
}


@pytest.mark.parametrize("coded_from", [64, 10_000])
@pytest.mark.parametrize("seed", range(12))
def test_after_any_changes_the_statistics_are_those_of_the_places_that_are_left(seed: int, coded_from: int) -> None:
    drives, rng = Drives(np.random.default_rng(seed)), np.random.default_rng(seed)
    index, reference = FaissIndex(SIZE, coded_from=coded_from), ExactIndex(SIZE)
    for _ in range(60):
        entries, vectors = drives.places(int(rng.choice([1, 5, 30])))
        gone = drives.gone() if rng.random() < 0.5 else []
        for changed in (index, reference):
            changed.add(entries, vectors)
            changed.remove(gone)
        if rng.random() < 0.3:
            index = CHANGED[rng.choice(list(CHANGED))](index, coded_from)
        if rng.random() < 0.7:
            assert learned(index) == as_bytes(learn_plainly(reference._rows, CONFIG))
    assert learned(index) == as_bytes(learn_plainly(reference._rows, CONFIG))
    assert sorted(index.ids().tolist()) == sorted(drives.kept)


@pytest.mark.parametrize("seed", range(4))
def test_after_any_changes_the_answers_are_those_of_the_places_that_are_left(seed: int) -> None:
    drives, rng = Drives(np.random.default_rng(seed)), np.random.default_rng(seed)
    index, reference = FaissIndex(SIZE), ExactIndex(SIZE)
    for _ in range(30):
        entries, vectors = drives.places(20)
        gone = drives.gone()
        for changed in (index, reference):
            changed.add(entries, vectors)
            changed.remove(gone)
        if rng.random() < 0.3:
            index = resumed(index, 4096)
        only = SearchFilter(of_session=entries[0].session, without=frozenset({entries[0].id, entries[1].id}))
        assert index.search(vectors[0], 9, only) == reference.search(vectors[0], 9, only)


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The rows whose descriptors are read."""
    rows: list[int] = []
    plain = Descriptors.__getitem__

    def noted(self: Descriptors, asked: Any) -> Array:
        rows.extend(np.asarray(asked, dtype=np.intp).tolist())
        return plain(self, asked)

    monkeypatch.setattr(Descriptors, "__getitem__", noted)
    return rows


def twenty_sessions() -> FaissIndex:
    """Twenty sessions of fifty places, row = id, searched by codes; the map's statistics are of the first 891."""
    rng = np.random.default_rng(1)
    index = FaissIndex(SIZE, coded_from=64)
    for session in range(20):
        entries = [IndexEntry(50 * session + i, session, i, np.array([9.0 * i, 0.0, 0.0])) for i in range(50)]
        index.add(entries, rng.normal(size=(50, SIZE)).astype(np.float32))
    index._learn()
    assert index._flat is None and index._learner._learned == 891
    return index


def another_session(count: int) -> tuple[list[IndexEntry], Array]:
    """Places of session 20, from id 1000 on."""
    entries = [IndexEntry(1000 + i, 20, i, np.array([9.0 * i, 0.0, 0.0])) for i in range(count)]
    return entries, np.random.default_rng(2).normal(size=(count, SIZE)).astype(np.float32)


def sessions_of(index: FaissIndex, rows: list[int]) -> set[int]:
    return set(index._rows.sessions[rows].tolist())


@pytest.mark.parametrize("restarted", [False, True])
def test_a_deletion_reads_its_session_and_those_that_now_teach_the_map(restarted: bool, read: list[int]) -> None:
    index = twenty_sessions()
    index = resumed(index, 64) if restarted else index
    index._learn()
    read.clear()
    index.remove([150])
    index._learn()
    assert sessions_of(index, read) == {3, 17}  # the first 891 end in session 17
    read.clear()
    index.remove(range(151, 200))
    index._learn()
    assert sessions_of(index, read) == {17, 18}


def test_a_place_that_did_not_count_is_removed_without_anything_being_read(read: list[int]) -> None:
    index = twenty_sessions()
    index.add([IndexEntry(1000, 3, 50, np.array([1.0, 0.0, 0.0]))], np.ones((1, SIZE), np.float32))
    before = learned(index)
    read.clear()
    index.remove([1000])
    assert (learned(index), read) == (before, [])


@pytest.mark.parametrize("array", ["in_map_totals", "of_session_sessions", "counted", "site_mean"])
def test_a_state_of_another_form_is_refused_by_name(array: str) -> None:
    with pytest.raises(DataLoss, match=array):
        resumed(twenty_sessions(), 64, array)


def test_a_step_of_growth_after_a_restart_reads_what_has_grown(read: list[int]) -> None:
    index = resumed(twenty_sessions(), 64)
    index.add(*another_session(113))
    read.clear()
    index._learn()
    assert index._learner._learned == 1113
    assert sessions_of(index, read) == {17, 18, 19, 20}


def test_a_map_that_swings_about_a_step_reads_no_more_than_has_changed(read: list[int]) -> None:
    index, (entries, vectors) = twenty_sessions(), another_session(113)
    index.add(entries, vectors)
    index._learn()
    for step in (891, 1113):
        if step == 891:
            index.remove([entries[-1].id])
        else:
            index.add(entries[-1:], vectors[-1:])
        read.clear()
        index._learn()
        assert index._learner._learned == step
        assert sessions_of(index, read) == {17, 20}


def groups_of_five() -> tuple[FaissIndex, Array]:
    """An index of 9,000 places, searched by codes; five each are much alike. And their descriptors."""
    rng = np.random.default_rng(3)
    alike = np.repeat(rng.normal(size=(1800, 64)), 5, axis=0) + 0.2 * rng.normal(size=(9000, 64))
    vectors = alike.astype(np.float32)
    index = FaissIndex(64, coded_from=64)
    index.add([IndexEntry(i, i // 500, i, np.array([10.0 * i, 0.0, 0.0])) for i in range(9000)], vectors)
    index.search(vectors[0], 1)
    return index, vectors


def assert_found_by_codes(index: FaissIndex, vectors: Array, first: int) -> None:
    """Each place from id `first` on is found with those that are like it."""
    assert index._codes is not None and index._codes.count == index._rows.count
    asked = range(first, 9000, 30)
    assert [{match.id // 5 for match in index.search(vectors[i], 5)} for i in asked] == [{i // 5} for i in asked]


def test_most_of_a_coded_map_is_removed_and_the_rest_keeps_its_codes() -> None:
    index, vectors = groups_of_five()
    index.remove(range(6000))
    assert index._rows.count == 3000
    assert_found_by_codes(index, vectors, 6000)


def test_the_codes_of_removed_places_are_stored_no_more_and_the_index_goes_on() -> None:
    index, vectors = groups_of_five()
    index.remove(range(3000))
    other = resumed(index, 64)
    assert (index._rows.count, other._rows.count) == (9000, 6000)
    for searched in (index, other):
        assert_found_by_codes(searched, vectors, 3000)


def test_no_codes_are_learned_from_the_few_places_that_are_left() -> None:
    entries, vectors = Drives(np.random.default_rng(5)).places(70)
    index = FaissIndex(SIZE, coded_from=64)
    index.add(entries[:64], vectors[:64])
    index = resumed(index, 64)
    index.remove(range(63))
    index.add(entries[64:], vectors[64:])
    assert {match.id for match in index.search(vectors[0], 9)} == set(range(63, 70))


def test_no_shared_row_becomes_the_processs_own_when_others_are_removed() -> None:
    drives = Drives(np.random.default_rng(4))
    entries, vectors = drives.places(300)
    index, reference = FaissIndex(SIZE), ExactIndex(SIZE)
    for changed in (index, reference):
        changed.add(entries[:200], vectors[:200])
    index = resumed(index, 4096)
    for changed in (index, reference):
        changed.add(entries[200:], vectors[200:])
        changed.remove([*range(190), *range(200, 260)])
    assert index.own_rows == 40
    assert index.shared_of(range(300)).tolist() == list(range(190, 200))
    for vector in vectors[::10]:
        assert index.search(vector, 5) == reference.search(vector, 5)
    assert index.differing(entries, vectors) == [*range(190), *range(200, 260)]
