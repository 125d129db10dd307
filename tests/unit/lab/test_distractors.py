"""Recall among many places that are none."""

from __future__ import annotations

import numpy as np
import pytest

from lab.distractors import fleet_recall, made_up_places
from revisit.evaluation.metrics import LoopProtocol


def drive(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Ten places, then the same ten again; unlike one another."""
    places = rng.normal(size=(10, 1_024))
    seen = np.concatenate([places, places + 0.3 * rng.normal(size=places.shape)])
    positions = np.column_stack([np.tile(100.0 * np.arange(10), 2), np.zeros(20), np.zeros(20)])
    return (seen / np.linalg.norm(seen, axis=1, keepdims=True)).astype(np.float32), positions


def test_made_up_places_are_unit_vectors_and_the_same_for_the_same_seed() -> None:
    pool, _ = drive(np.random.default_rng(0))
    first, again = (made_up_places(pool, 50, np.random.default_rng(1)) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    np.testing.assert_allclose(np.linalg.norm(first, axis=1), 1.0, atol=1e-5)


def test_places_that_stand_out_are_found_among_any_number_of_others() -> None:
    vectors, positions = drive(np.random.default_rng(0))
    others, _ = drive(np.random.default_rng(5))
    distractors = made_up_places(others, 300, np.random.default_rng(1))
    found = fleet_recall(vectors, positions, distractors, LoopProtocol(min_index_gap=3))
    assert (found.distractors, found.queries) == (300, 10)
    assert found.recall_at_20 == 1.0


def test_distractors_that_are_the_queries_themselves_take_the_first_answers() -> None:
    vectors, positions = drive(np.random.default_rng(0))
    found = fleet_recall(vectors, positions, np.repeat(vectors, 20, axis=0), LoopProtocol(min_index_gap=3))
    assert found.recall_at_20 == pytest.approx(0.0) and found.recall_at_1 == pytest.approx(0.0)
