"""Descriptors are standardised by the places of their own map, without labels."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from revisit.core.config import AdaptationConfig
from revisit.core.descriptor.adaptation import SessionSums, learn_site, learned_from
from revisit.core.index import (
    ExactIndex,
    FaissIndex,
    IndexEntry,
    Match,
    PlaceIndex,
    RowDiffers,
    SearchFilter,
    SharedRows,
)

SIZE = 64
Array = NDArray[np.float32]


def visits(common: Array, places: Array, noise: float, seed: int) -> Array:
    """Unit descriptors of visits to `places` (n, d), which all have `common` (d,) in them."""
    rng = np.random.default_rng(seed)
    seen = common + places + noise * rng.normal(size=places.shape)
    return np.asarray(seen / np.linalg.norm(seen, axis=1, keepdims=True), dtype=np.float32)


def drawn(count: int, seed: int) -> Array:
    return np.random.default_rng(seed).normal(size=(count, SIZE)).astype(np.float32) / np.float32(np.sqrt(SIZE))


def entries(first: int, count: int, session: int = 1, spacing_m: float = 10.0) -> list[IndexEntry]:
    return [IndexEntry(first + i, session, i, np.array([spacing_m * i, 0.0, 0.0])) for i in range(count)]


def filled(vectors: Array, session: int = 1, spacing_m: float = 10.0) -> FaissIndex:
    index = FaissIndex(SIZE)
    index.add(entries(0, len(vectors), session, spacing_m), vectors)
    return index


def beside(identifier: int, gap: int) -> frozenset[int]:
    """The places that came less than `gap` before or after one, and itself."""
    return frozenset(range(identifier - gap + 1, identifier + gap))


def answers(index: PlaceIndex, queries: Array, only: SearchFilter = SearchFilter()) -> list[list[Match]]:
    return [index.search(query, 5, only) for query in queries]


def test_what_all_places_of_a_map_share_no_longer_makes_them_alike() -> None:
    common, places = 3.0 * drawn(1, seed=0)[0], drawn(120, seed=1)
    known, new = visits(common, places[:100], 0.02, seed=2), visits(common, places[100:], 0.02, seed=3)
    assert (known @ new.T).max() > 0.9  # places that were never seen look like loops
    assert max(found[0].similarity for found in answers(filled(known), new)) < 0.7
    again = visits(common, places[:100], 0.02, seed=4)
    assert [found[0].id for found in answers(filled(known), again)] == list(range(100))
    assert min(found[0].similarity for found in answers(filled(known), again)) > 0.7


def test_a_session_of_another_sensor_is_taken_relative_to_its_own_mean() -> None:
    places, shift = drawn(100, seed=1), 4.0 * drawn(1, seed=5)[0]
    first, second = visits(0 * shift, places, 0.05, seed=2), visits(shift, places, 0.05, seed=3)
    index = filled(first)
    asks = SearchFilter(only_session=1)
    before = [found[0].id for found in answers(index, second, asks)]
    index.add(entries(100, 100, session=2), second)
    told = SearchFilter(only_session=1, of_session=2)
    after = [found[0].id for found in answers(index, second, told)]
    right = list(range(100))
    assert np.mean(np.equal(before, right)) < 0.8
    assert np.mean(np.equal(after, right)) > 0.95


def test_few_places_change_nothing() -> None:
    vectors = drawn(7, seed=1)
    unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    found = filled(vectors).search(vectors[0], 7)
    assert [match.similarity for match in found] == pytest.approx(np.sort(unit @ unit[0])[::-1], abs=1e-6)


def test_a_robot_that_waits_teaches_one_place_only() -> None:
    vectors = visits(drawn(1, seed=0)[0], 0.01 * drawn(200, seed=1), 0.0, seed=2)
    waiting = filled(vectors, spacing_m=0.001)
    assert waiting.search(vectors[0], 200)[-1].similarity > 0.99
    assert filled(vectors, spacing_m=10.0).search(vectors[0], 200)[-1].similarity < 0.9


def test_the_answers_do_not_depend_on_how_the_places_came() -> None:
    vectors = np.concatenate(
        [visits(drawn(1, 0)[0], drawn(60, 1), 0.1, 2), visits(drawn(1, 3)[0], drawn(47, 4), 0.1, 5)]
    )
    all_entries = entries(0, 60) + entries(60, 47, session=2)
    at_once, one_by_one = FaissIndex(SIZE), FaissIndex(SIZE)
    at_once.add(all_entries, vectors)
    for row, entry in enumerate(all_entries):
        one_by_one.add([entry], vectors[row : row + 1])
        one_by_one.search(vectors[row], 3, SearchFilter(of_session=entry.session, without=beside(entry.id, 2)))
    queries = drawn(20, seed=6)
    assert answers(one_by_one, queries) == answers(at_once, queries)
    assert one_by_one.differing(all_entries, vectors) == []


def test_a_place_that_was_removed_leaves_nothing_behind() -> None:
    vectors = visits(drawn(1, 0)[0], drawn(90, 1), 0.1, seed=2)
    index, queries = filled(vectors), drawn(20, seed=3)
    answers(index, queries)
    index.remove(list(range(0, 90, 3)))
    left = [row for row in range(90) if row % 3]
    other = FaissIndex(SIZE)
    other.add([entries(0, 90)[row] for row in left], vectors[left])
    assert answers(index, queries) == answers(other, queries)
    index.remove(left)
    assert len(index) == 0 and answers(index, queries) == [[]] * 20


def test_a_descriptor_that_was_changed_inside_is_noticed() -> None:
    vectors = visits(drawn(1, 0)[0], drawn(30, 1), 0.1, seed=2)
    index = filled(vectors)
    index.search(vectors[0], 1)
    assert index._flat is not None
    index._flat._stored()[4, 0] += 1.0
    index._rows.vectors._blocks[0][9, 0] += 1.0
    assert index.differing(entries(0, 30), vectors) == [4, 9]


def test_statistics_are_learned_in_steps() -> None:
    config = AdaptationConfig()
    steps = {learned_from(count, config) for count in range(1000)}
    assert [learned_from(count, config) for count in (0, 7, 8, 9, 10)] == [0, 0, 8, 8, 10]
    assert len(steps) < 25
    assert all(learned_from(step, config) == step for step in steps)


def test_adapting_rows_apart_gives_the_same_bits() -> None:
    vectors, sessions = drawn(50, seed=1), np.arange(50) % 3
    seen = {session: SessionSums.of(vectors[sessions == session]) for session in range(3)}
    site = learn_site(seen, AdaptationConfig()).with_sessions({1: SessionSums.of(vectors[:9])})
    together = site.adapted(vectors, sessions)
    apart = np.concatenate([site.adapted(vectors[i : i + 1], sessions[i : i + 1]) for i in range(50)])
    assert together.tobytes() == apart.tobytes()
    assert np.linalg.norm(together, axis=1) == pytest.approx(np.ones(50), abs=1e-6)


def test_cosines_are_those_of_the_adapted_descriptors_and_the_same_bits_apart() -> None:
    vectors, sessions = drawn(50, seed=1), np.arange(50) % 3
    seen = {session: SessionSums.of(vectors[sessions == session]) for session in range(3)}
    site = learn_site(seen, AdaptationConfig()).with_sessions(seen)
    vectors[[7, 8]] = site.session_means[1], site.session_means[2]  # nothing is left of these, so they stay as they are
    query = site.adapted(vectors[:1], np.array([-1]))[0]
    found = site.cosines(vectors, sessions, query)
    np.testing.assert_allclose(found, site.adapted(vectors, sessions) @ query, atol=3e-7)
    assert abs(found[7] - vectors[7] @ query) < 1e-6
    apart = [site.cosines(vectors[i : i + 1], sessions[i : i + 1], query) for i in range(50)]
    assert found.tobytes() == np.concatenate(apart).tobytes()
    assert site.cosines(vectors[:0], sessions[:0], query).shape == (0,)


def places_of_sessions(count: int, seed: int) -> tuple[list[IndexEntry], Array]:
    """Places of five sessions, each with a mean of its own; every third lies where the one before it lies."""
    rng = np.random.default_rng(seed)
    sessions = rng.integers(5, size=count)
    vectors = visits(drawn(1, 0)[0], drawn(5, 1)[sessions] + drawn(count, 2), 0.1, seed)
    listed = [
        IndexEntry(row, int(session), row, np.array([10.0 * (row - (row % 3 == 2)), 0.0, 0.0]))
        for row, session in enumerate(sessions)
    ]
    return listed, vectors


def test_what_is_learned_place_by_place_is_what_the_reference_learns_from_all() -> None:
    listed, vectors = places_of_sessions(150, seed=3)
    step_by_step, reference = FaissIndex(SIZE), ExactIndex(SIZE)
    for row, entry in enumerate(listed):
        step_by_step.add([entry], vectors[row : row + 1])
        reference.add([entry], vectors[row : row + 1])
        if row == 90:
            for index in (step_by_step, reference):
                index.remove([1, 4, 5, 30])
        only = SearchFilter(of_session=entry.session, without=beside(entry.id, 3))
        assert step_by_step.search(vectors[row], 4, only) == reference.search(vectors[row], 4, only)


def test_a_map_searched_by_codes_answers_as_the_reference_does() -> None:
    listed, vectors = places_of_sessions(1500, seed=4)
    coded, reference = FaissIndex(SIZE, coded_from=100), ExactIndex(SIZE)
    for start in range(0, 1500, 50):
        for index in (coded, reference):
            index.add(listed[start : start + 50], vectors[start : start + 50])
    coded.remove([7])
    reference.remove([7])
    assert coded._flat is None and coded._codes is not None
    again = vectors + np.float32(0.05) * drawn(1500, seed=9)
    alike = [
        [match.id for match in coded.search(again[row], 5, only)]
        == [match.id for match in reference.search(again[row], 5, only)]
        for row in range(0, 1500, 15)
        for only in (
            SearchFilter(),
            SearchFilter(only_session=2),
            SearchFilter(of_session=listed[row].session, without=beside(row, 20)),
        )
    ]
    assert np.mean(alike) >= 0.99


@pytest.mark.parametrize("coded_from", [100, 10_000])
def test_an_index_that_another_process_takes_up_goes_on_as_if_it_were_the_same(coded_from: int) -> None:
    listed, vectors = places_of_sessions(600, seed=6)
    unbroken, resumed = FaissIndex(SIZE, coded_from=coded_from), FaissIndex(SIZE, coded_from=coded_from)
    queries = vectors[::20] + np.float32(0.05) * drawn(30, seed=9)
    for start in range(0, 600, 120):
        for index in (unbroken, resumed):
            index.add(listed[start : start + 120], vectors[start : start + 120])
            index.remove([start + 3, start // 2])
        only = SearchFilter(of_session=start % 5, without=beside(start, 20))
        assert answers(resumed, queries, only) == answers(unbroken, queries, only)
        stored = resumed.stored()
        shared, marks = (np.concatenate(parts) for parts in zip(*stored.portions(), strict=True))
        rows = SharedRows(stored.arrays["ids"], shared, marks)
        resumed = FaissIndex.restored(rows, stored.arrays, coded_from=coded_from)
        assert (resumed.own_rows, resumed._flat is None) == (0, unbroken._flat is None)
        assert answers(resumed, queries, only) == answers(unbroken, queries, only)


@pytest.mark.parametrize("erased", [True, False])
def test_nothing_is_answered_from_a_shared_row_that_was_changed(erased: bool) -> None:
    listed, vectors = places_of_sessions(60, seed=7)
    index = FaissIndex(SIZE)
    index.add(listed, vectors)
    stored = index.stored()
    shared, marks = (np.concatenate(parts) for parts in zip(*stored.portions(), strict=True))
    other = FaissIndex.restored(SharedRows(stored.arrays["ids"], shared, marks), stored.arrays)
    if erased:
        shared[9] = 0.0
    else:
        shared.view(np.uint32)[9, 5] ^= 1
    with pytest.raises(RowDiffers):
        other.search(vectors[9], 1)
    assert [entry.id for entry in listed if entry.id in other._rows.differing(listed, vectors)] == [9]


def test_codes_are_made_while_places_come_and_searches_ask() -> None:
    listed, vectors = places_of_sessions(900, seed=5)
    index = FaissIndex(SIZE, coded_from=800)
    index.add(listed[:800], vectors[:800])
    index.search(vectors[0], 1)
    assert index._codes is None and index._next_codes is None
    index.add(listed[800:], vectors[800:])
    assert index._flat is not None and index._next_codes is not None  # all are compared until the codes are ready
    before = index.search(vectors[5], 3)
    for _ in range(4):
        assert index.search(vectors[5], 3) == before
    assert index._flat is None and index._codes is not None
    index.remove(list(range(700)))
    assert {match.id for match in index.search(vectors[5], 3)} <= set(range(700, 900))
