"""What every PlaceIndex promises, checked on each implementation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from revisit.core.config import AdaptationConfig
from revisit.core.errors import BadField
from revisit.core.index import ExactIndex, FaissIndex, IndexEntry, PlaceIndex, SearchFilter, SharedRows

DIMENSION = 16


PLAIN = AdaptationConfig(first_places=10_000)
"""No statistics are learned from as few places as these tests show."""


def exact(dimension: int) -> ExactIndex:
    """The reference."""
    return ExactIndex(dimension, PLAIN)


def flat(dimension: int) -> FaissIndex:
    """The index of the service with as few places as are all compared."""
    return FaissIndex(dimension, PLAIN, coded_from=10_000)


def coded(dimension: int) -> FaissIndex:
    """The index of the service, which searches by codes soon."""
    return FaissIndex(dimension, PLAIN, coded_from=64)


class Resumed:
    """The index of the service, left after every change by one process and taken up by the next, as from a file."""

    def __init__(self, dimension: int) -> None:
        self._index = coded(dimension)

    def add(self, entries: Sequence[IndexEntry], vectors: NDArray[np.float32], *, more: bool = False) -> None:
        self._index.add(entries, vectors, more=more)
        self._index = taken_up(self._index)

    def __len__(self) -> int:
        return len(self._index)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._index, name)


def taken_up(index: FaissIndex) -> FaissIndex:
    """What another process makes of it, whose descriptors are all shared."""
    stored = index.stored()
    vectors, marks = (np.concatenate(parts) for parts in zip(*stored.portions(), strict=True))
    shared = SharedRows(stored.arrays["ids"], vectors, marks)
    return FaissIndex.restored(shared, stored.arrays, PLAIN, coded_from=64)


@pytest.fixture(params=[exact, flat, coded, Resumed])
def index(request: pytest.FixtureRequest) -> PlaceIndex:
    built: PlaceIndex = request.param(DIMENSION)
    return built


def entry(identifier: int, session: int = 0, ordinal: int = 0, x: float = 0.0) -> IndexEntry:
    """A place on the x axis."""
    return IndexEntry(identifier, session, ordinal, np.array([x, 0.0, 0.0]))


def random_vectors(count: int, seed: int = 0) -> NDArray[np.float32]:
    """Directions drawn evenly."""
    return np.random.default_rng(seed).normal(size=(count, DIMENSION)).astype(np.float32)


def brute_force(vectors: NDArray[np.float32], query: NDArray[np.float32], rows: NDArray[np.int64], k: int) -> list[int]:
    """Ids (= rows) by falling cosine."""
    unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    order = rows[np.argsort(-(unit[rows] @ query), kind="stable")]
    return [int(row) for row in order[:k]]


def test_the_most_similar_places_come_first(index: PlaceIndex) -> None:
    vectors = random_vectors(300)
    index.add([entry(i) for i in range(300)], vectors)
    for query in random_vectors(20, seed=1):
        assert [match.id for match in index.search(query, 10)] == brute_force(vectors, query, np.arange(300), 10)


def test_nothing_is_missed_under_a_filter_that_keeps_one_place_in_a_thousand(index: PlaceIndex) -> None:
    vectors = random_vectors(2000)
    index.add([entry(i, session=i % 1000) for i in range(2000)], vectors)
    rows = np.flatnonzero(np.arange(2000) % 1000 == 7)
    query = random_vectors(1, seed=2)[0]
    found = [match.id for match in index.search(query, 5, SearchFilter(only_session=7))]
    assert found == brute_force(vectors, query, rows, 5)


@pytest.mark.parametrize("last", [0, 1, 37])
def test_places_that_come_in_portions_are_found_whatever_the_last_one_holds(index: PlaceIndex, last: int) -> None:
    vectors = random_vectors(400 + last)
    for start in range(0, 400, 80):
        index.add([entry(i) for i in range(start, start + 80)], vectors[start : start + 80], more=True)
        query = vectors[start]
        found = index.search(query, 10)
        assert [match.id for match in found] == brute_force(vectors, query, np.arange(start + 80), 10)
    index.add([entry(i) for i in range(400, 400 + last)], vectors[400:])
    for query in random_vectors(20, seed=9):
        expected = brute_force(vectors, query, np.arange(400 + last), 10)
        assert [match.id for match in index.search(query, 10)] == expected


@pytest.mark.parametrize(
    ("only", "expected"),
    [
        (SearchFilter(exclude_session=0), {3}),
        (SearchFilter(only_session=0), {0, 1, 2}),
        (SearchFilter(only_sessions=frozenset({1, 9})), {3}),
        (SearchFilter(only_sessions=frozenset({0, 1}), exclude_session=1), {0, 1, 2}),
        (SearchFilter(only_sessions=frozenset()), set()),
        (SearchFilter(of_session=0, without=frozenset({1, 2, 99})), {0, 3}),
        (SearchFilter(position=np.array([10.0, 0, 0]), radius_m=10.0), {0, 1, 2}),
        (SearchFilter(allowed=frozenset({1, 3, 99})), {1, 3}),
        (SearchFilter(only_session=0, allowed=frozenset({3})), set()),
    ],
)
def test_a_filter_keeps_exactly_what_it_says(index: PlaceIndex, only: SearchFilter, expected: set[int]) -> None:
    entries = [entry(0, 0, 0, 0), entry(1, 0, 1, 10), entry(2, 0, 2, 20), entry(3, 1, 2, 30)]
    index.add(entries, random_vectors(4))
    assert {match.id for match in index.search(random_vectors(1)[0], 10, only)} == expected


def test_places_are_counted_by_session_without_those_that_were_removed(index: PlaceIndex) -> None:
    index.add([entry(i, session=i % 3) for i in range(9)], random_vectors(9))
    index.remove([0, 4])
    assert [index.count_of({0}), index.count_of({0, 1}), index.count_of({7}), index.count_of(())] == [2, 4, 0, 0]


def test_equally_similar_places_come_by_id(index: PlaceIndex) -> None:
    same = np.tile(random_vectors(1), (40, 1))
    index.add([entry(i) for i in reversed(range(40))], same)
    assert [match.id for match in index.search(same[0], 3)] == [0, 1, 2]


@pytest.mark.parametrize("step", [1e-5, 1e-4, 1e-3])
def test_places_come_in_their_order_where_half_precision_cannot_tell_them_apart(step: float) -> None:
    base = random_vectors(1)
    vectors = base / np.linalg.norm(base) + step * random_vectors(2000, seed=1)
    entries = [entry(i) for i in range(len(vectors))]
    indices = exact(DIMENSION), flat(DIMENSION)
    for built in indices:
        built.add(entries, vectors)
    for query in random_vectors(20, seed=2):
        assert indices[1].search(query, 10) == indices[0].search(query, 10)


def test_removed_places_are_not_found_and_may_come_back(index: PlaceIndex) -> None:
    vectors = random_vectors(3)
    index.add([entry(i) for i in range(3)], vectors)
    index.remove([1, 77])
    assert len(index) == 2
    assert {match.id for match in index.search(vectors[1], 10)} == {0, 2}
    index.add([entry(1)], vectors[1:2])
    assert index.search(vectors[1], 1)[0].id == 1


def test_similarity_is_the_cosine(index: PlaceIndex) -> None:
    vector = random_vectors(1)
    index.add([entry(0)], 3.0 * vector)
    assert index.search(-7.0 * vector[0], 1)[0].similarity == pytest.approx(-1.0, abs=1e-6)


def test_an_empty_index_finds_nothing(index: PlaceIndex) -> None:
    assert index.search(random_vectors(1)[0], 5) == []
    assert len(index) == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0])
def test_unusable_vectors_are_refused_and_nothing_is_stored(index: PlaceIndex, bad: float) -> None:
    vectors = random_vectors(2)
    vectors[1] = bad
    with pytest.raises(BadField):
        index.add([entry(0), entry(1)], vectors)
    assert len(index) == 0
    with pytest.raises(BadField):
        index.search(vectors[1], 1)


def test_wrong_dimensions_and_k_below_one_are_refused(index: PlaceIndex) -> None:
    with pytest.raises(BadField):
        index.add([entry(0)], np.ones((1, DIMENSION + 1), np.float32))
    with pytest.raises(BadField):
        index.search(np.ones(DIMENSION - 1, np.float32), 1)
    with pytest.raises(BadField):
        index.search(np.ones(DIMENSION, np.float32), 0)


def test_an_id_is_stored_once(index: PlaceIndex) -> None:
    index.add([entry(5)], random_vectors(1))
    with pytest.raises(BadField):
        index.add([entry(5)], random_vectors(1))
    with pytest.raises(BadField):
        index.add([entry(6), entry(6)], random_vectors(2))
    assert len(index) == 1


def test_what_is_stored_differs_in_nothing_also_after_removals(index: PlaceIndex) -> None:
    vectors, entries = random_vectors(40), [entry(i, session=i % 3, ordinal=i, x=i / 7) for i in range(40)]
    index.add(entries, vectors)
    index.remove([3, 17, 39])
    kept = [row for row in range(40) if row not in (3, 17, 39)]
    assert sorted(index.ids().tolist()) == kept
    assert index.differing([entries[row] for row in kept], vectors[kept]) == []
    assert index.differing(entries, vectors) == [3, 17, 39]


@pytest.mark.parametrize("field", ["session", "ordinal", "x"])
def test_other_metadata_differ(index: PlaceIndex, field: str) -> None:
    index.add([entry(1), entry(2)], random_vectors(2))
    assert index.differing([entry(1), entry(2, **{field: 1})], random_vectors(2)) == [2]


def test_one_bit_of_a_vector_makes_a_difference(index: PlaceIndex) -> None:
    unit = np.eye(DIMENSION, dtype=np.float32)[:2]
    index.add([entry(1), entry(2)], unit)
    other = unit.copy()
    # Of a unit vector along an axis: a bit that the norm does not see.
    other.view(np.uint32)[1, 5] ^= 1
    assert index.differing([entry(1), entry(2)], other) == [2]


def test_places_that_come_and_go_take_no_more_room_and_change_no_answer(index: PlaceIndex) -> None:
    vectors = random_vectors(1000)
    for identifier in range(1000):
        index.add([entry(identifier, session=identifier, x=float(identifier))], vectors[identifier : identifier + 1])
        index.remove([identifier - 40])
    assert len(index) == 40
    assert len(index._rows.vectors) <= 256  # type: ignore[attr-defined]  # of either implementation
    rows, query = np.arange(960, 1000), random_vectors(1, seed=3)[0]
    assert [match.id for match in index.search(query, 5)] == brute_force(vectors, query, rows, 5)
    assert [match.id for match in index.search(query, 5, SearchFilter(only_session=970))] == [970]
    assert index.differing([entry(i, session=i, x=float(i)) for i in rows.tolist()], vectors[rows]) == []
