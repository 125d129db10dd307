"""An index grows without copying what it holds, and is fast once the last portion of many has come."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from revisit.core.index import FaissIndex, IndexEntry, descriptors
from revisit.core.index.descriptors import Descriptors, SharedRows, marks_of

DIMENSION = 8


def drawn(count: int, seed: int = 0) -> NDArray[np.float32]:
    """Rows of random entries."""
    return np.random.default_rng(seed).normal(size=(count, DIMENSION)).astype(np.float32)


@pytest.fixture(params=[0, 20], ids=["none shared", "some shared"])
def shared(request: pytest.FixtureRequest) -> SharedRows | None:
    """The first rows."""
    count: int = request.param
    vectors, ids = drawn(count, seed=3), np.arange(count)
    return SharedRows(ids, vectors, marks_of(ids, vectors)) if count else None


def test_rows_are_the_same_in_however_many_blocks_they_lie(
    shared: SharedRows | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(descriptors, "_COPIED_BELOW", 16)
    held = Descriptors(DIMENSION, shared)
    expected = drawn(0) if shared is None else shared.vectors
    for step, size in enumerate((3, 9, 40, 41, 100, 300)):
        added = drawn(size - (len(expected) - held.shared_count), seed=step)
        held.reserve(held.shared_count + size)
        held.put(len(expected), added)
        expected = np.concatenate([expected, added])
        rows = np.random.default_rng(step).permutation(len(expected))
        np.testing.assert_array_equal(held[rows], expected[rows])
        np.testing.assert_array_equal(np.array([held.as_held(row) for row in rows]), expected[rows])
    assert len(held._blocks) > 2
    kept = np.concatenate([np.arange(held.shared_count), np.arange(held.shared_count, len(expected), 3)])
    np.testing.assert_array_equal(held.only(kept)[np.arange(len(kept))], expected[kept])


def test_large_blocks_stay_where_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(descriptors, "_COPIED_BELOW", 16)
    held = Descriptors(DIMENSION)
    held.reserve(32)
    first, frozen = held._blocks[0], held.frozen()
    held.put(0, drawn(32))
    held.reserve(64)
    held.put(32, drawn(32, seed=1))
    assert held._blocks[0] is first
    np.testing.assert_array_equal(frozen[range(32)], drawn(32))


def test_codes_are_made_once_and_of_all_when_the_last_of_many_portions_has_come() -> None:
    index, vectors = FaissIndex(DIMENSION, coded_from=64), drawn(1000)
    entries = [IndexEntry(i, 0, i, np.array([5.0 * i, 0.0, 0.0])) for i in range(1000)]
    for start in range(0, 1000, 100):
        index.add(entries[start : start + 100], vectors[start : start + 100], more=True)
        assert index.codes_learned_at == 0
    index.add([], vectors[:0])
    assert index.codes_learned_at == 1000
    assert index._compared() == 1000
