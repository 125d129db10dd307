"""The contract of VectorIndex: the reference in memory, and the structures of core.index behind the adapter."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.errors import BadField
from revisit.core.index import ExactIndex, FaissIndex
from revisit.service.engines.local.files.index_files import IndexFiles
from revisit.service.engines.local.vector_index import PlaceVectorIndex
from revisit.service.ports.index import IndexChange, VectorFilter
from tests.support.memory.vector_index import MemoryVectorIndex

ANY = VectorFilter()
MAP = 5


class SavedEachTime(PlaceVectorIndex):
    """It goes on from a file after every change."""

    def apply(self, map_number, changes, after=0):
        super().apply(map_number, changes, after)
        if (name := self.save(map_number)) is not None:
            assert self.load(map_number, name)


@pytest.fixture(params=["memory", "exact", "faiss", "file"])
def index(request, tmp_path):
    if request.param == "file":
        return SavedEachTime(FaissIndex, IndexFiles(tmp_path / "index"), saved_from=1)
    makers = {"exact": ExactIndex, "faiss": FaissIndex}
    return MemoryVectorIndex() if request.param == "memory" else PlaceVectorIndex(makers[request.param])


def unit(*values: float) -> np.ndarray:
    vector = np.array(values, dtype=np.float32)
    return vector / np.linalg.norm(vector)


def added(seq, number, vector, session=1, ordinal=0, position=(0.0, 0.0, 0.0)) -> IndexChange:
    return IndexChange(seq, number, session, ordinal, position, vector.astype("<f4").tobytes())


def removed(seq, number) -> IndexChange:
    return IndexChange(seq, number, 0, 0, (0.0, 0.0, 0.0), None)


def numbers(index, vector, k=10, where=ANY) -> list[int]:
    return [match.submap_number for match in index.search(MAP, vector, k, where)]


def test_an_unknown_map_is_empty(index):
    assert (index.seq(MAP), index.size(MAP), index.search(MAP, unit(1, 0), 3, ANY)) == (0, 0, [])


def test_the_nearest_come_first_with_their_cosine_and_ties_by_number(index):
    index.apply(MAP, [added(1, 30, unit(1, 0)), added(2, 20, unit(1, 0)), added(3, 10, unit(1, 1))])
    matches = index.search(MAP, unit(1, 0), 3, ANY)
    assert [match.submap_number for match in matches] == [20, 30, 10]
    assert [match.similarity for match in matches] == pytest.approx([1.0, 1.0, 0.5**0.5], abs=1e-6)
    assert numbers(index, unit(1, 0), k=1) == [20]


def test_changes_are_applied_once_and_in_order(index):
    changes = [added(1, 10, unit(1, 0)), added(2, 11, unit(0, 1)), removed(3, 10)]
    index.apply(MAP, changes)
    index.apply(MAP, changes)
    index.apply(MAP, [added(2, 99, unit(1, 0))])
    assert (index.seq(MAP), index.size(MAP), numbers(index, unit(1, 0))) == (3, 1, [11])


def test_removing_what_was_never_there_moves_the_sequence_on(index):
    index.apply(MAP, [removed(1, 10)])
    assert (index.seq(MAP), index.size(MAP)) == (1, 0)
    index.apply(MAP, [added(2, 11, unit(0, 1))])
    assert numbers(index, unit(0, 1)) == [11]


def test_maps_do_not_see_each_other_and_can_be_dropped(index):
    index.apply(MAP, [added(1, 10, unit(1, 0))])
    index.apply(6, [added(2, 11, unit(1, 0))])
    assert numbers(index, unit(1, 0)) == [10]
    index.drop(MAP)
    assert (index.seq(MAP), index.size(MAP), index.size(6)) == (0, 0, 1)


def test_filters_keep_what_they_say(index):
    index.apply(
        MAP,
        [
            added(1, 10, unit(1, 0), session=1, ordinal=0, position=(0.0, 0.0, 0.0)),
            added(2, 11, unit(1, 0), session=1, ordinal=3, position=(3.0, 4.0, 0.0)),
            added(3, 12, unit(1, 0), session=2, ordinal=3, position=(50.0, 0.0, 0.0)),
        ],
    )
    query = unit(1, 0)
    assert numbers(index, query, where=VectorFilter(of_session=1, without=frozenset({10}))) == [11, 12]
    assert numbers(index, query, where=VectorFilter(exclude_session=1)) == [12]
    assert numbers(index, query, where=VectorFilter(only_session=1)) == [10, 11]
    assert numbers(index, query, where=VectorFilter(only_sessions=frozenset({2, 5}))) == [12]
    assert numbers(index, query, where=VectorFilter(only_sessions=frozenset())) == []
    assert [index.size(MAP, {1}), index.size(MAP, {1, 2}), index.size(MAP, ())] == [2, 3, 0]
    near = VectorFilter(position_m=(0.0, 0.0, 0.0), radius_m=5.0)
    assert numbers(index, query, where=near) == [10, 11]


def test_a_filter_that_keeps_one_in_a_thousand_still_finds_it(index):
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(1000, 16)).astype(np.float32)
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    index.apply(MAP, [added(n + 1, n + 1, vectors[n], session=7 if n == 613 else 1) for n in range(1000)])
    assert numbers(index, vectors[0], k=5, where=VectorFilter(only_session=7)) == [614]


@pytest.mark.parametrize("vector", [np.float32([1, 0, 0]), np.float32([np.nan, 0])])
def test_a_descriptor_that_cannot_be_compared_is_refused(index, vector):
    index.apply(MAP, [added(1, 10, unit(1, 0))])
    with pytest.raises(BadField):
        index.search(MAP, vector, 3, ANY)


def test_it_tells_what_it_holds_and_as_of_which_change(index):
    assert [index.numbers(MAP)[0], index.numbers(MAP)[1].tolist()] == [0, []]
    index.apply(MAP, [added(1, 10, unit(1, 0)), added(2, 11, unit(0, 1)), removed(3, 10)])
    seq, held = index.numbers(MAP)
    assert (seq, held.tolist()) == (3, [11])


def test_it_tells_which_places_it_does_not_hold_exactly_so(index):
    right = [added(1, 10, unit(1, 0), ordinal=1), added(2, 11, unit(0, 1), ordinal=2)]
    assert index.differing(MAP, right) == [10, 11]
    index.apply(MAP, right)
    assert index.differing(MAP, right) == index.differing(MAP, []) == []
    assert index.differing(MAP, [right[0], added(2, 11, unit(0, 1), ordinal=3)]) == [11]
    assert index.differing(MAP, [added(1, 10, unit(1, 1), ordinal=1), right[1]]) == [10]


def test_changes_that_follow_others_are_ignored_once_the_map_was_forgotten(index):
    index.apply(MAP, [added(1, 10, unit(1, 0))])
    index.drop(MAP)
    index.apply(MAP, [added(2, 11, unit(0, 1))], after=1)
    assert (index.seq(MAP), index.size(MAP)) == (0, 0)


def test_a_file_is_worth_it_for_a_large_map_and_again_once_an_eighth_has_come(tmp_path):
    index = PlaceVectorIndex(FaissIndex, IndexFiles(tmp_path / "index"), saved_from=16)
    vectors = np.random.default_rng(0).normal(size=(200, 8)).astype(np.float32)
    saved = []
    for number in range(1, 201):
        index.apply(MAP, [added(number, number, vectors[number - 1])])
        if (name := index.save(MAP)) is not None:
            assert index.load(MAP, name)
            saved.append(number)
    assert saved == [16, 32, 48, 64, 80, 96, 112, 128, 146, 166, 189]
    assert index.large() == [MAP]
    reader = PlaceVectorIndex(FaissIndex, IndexFiles(tmp_path / "index"))
    assert reader.save(MAP) is None
