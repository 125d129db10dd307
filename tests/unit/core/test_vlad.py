"""Aggregation and codebooks, by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lab.training.codebooks import discriminant_directions, random_folds
from revisit.core.descriptor.vlad import Codebooks, aggregate, fold
from revisit.core.errors import DataLoss


def small_books() -> Codebooks:
    """Two principal components, two centres each."""
    identity, centres = np.eye(2, dtype=np.float32), np.array([[0, 0], [10, 0]], np.float32)
    four = np.eye(4, dtype=np.float32)
    zeros, folds = np.zeros(4, np.float32), np.array([[1, -2, 3, -1], [2, 3, -1, 2]], np.float32)
    parity = np.array([1, -1], np.float32)
    return Codebooks(identity, parity, centres, zeros, folds, centres, zeros, folds, *[zeros, four] * 3)


def test_residuals_are_summed_normalised_by_centre_and_rooted() -> None:
    features = np.array([[1, 0], [2, 4], [10, -5]], dtype=np.float32)
    # residual sums (3, 4) and (0, -5); by block (0.6, 0.8) and (0, -1); signed roots; L2 norm of all is sqrt(2.4)
    expected = np.array([0.6**0.5, 0.8**0.5, 0.0, -1.0]) / np.sqrt(2.4)
    np.testing.assert_allclose(aggregate(features, small_books().macro_centres), expected, atol=1e-6)


def test_weights_scale_the_residuals_after_assignment() -> None:
    features = np.array([[11, 0], [10, 1]], dtype=np.float32)
    vector = aggregate(features, small_books().macro_centres, np.array([0.8, 0.6]))
    np.testing.assert_allclose(vector, np.array([0, 0, 0.8**0.5, 0.6**0.5]) / np.sqrt(1.4), atol=1e-6)


def test_the_literal_form_moves_weighted_features_to_other_centres() -> None:
    features = np.array([[10.0, 1.0]], dtype=np.float32)
    literal = aggregate(features, small_books().macro_centres, np.array([0.1]), weigh_features=True)
    assert literal[:2].any()  # 0.1 * (10, 1) is nearer to the origin than to (10, 0)
    assert not literal[2:].any()


def test_no_features_aggregate_to_zeros_and_stay_zeros() -> None:
    nothing = aggregate(np.zeros((0, 2), np.float32), small_books().macro_centres)
    assert not nothing.any()
    assert not fold(nothing, np.ones(4, np.float32), small_books().macro_folds).any()


def test_codebooks_survive_their_arrays() -> None:
    restored = Codebooks.from_arrays(small_books().to_arrays())
    for name, array in small_books().to_arrays().items():
        np.testing.assert_array_equal(getattr(restored, name), array)


def test_codebooks_whose_shapes_disagree_are_refused() -> None:
    with pytest.raises(DataLoss):
        Codebooks.from_arrays(replace(small_books(), macro_mean=np.zeros(3, np.float32)).to_arrays())
    with pytest.raises(DataLoss, match="micro_folds"):
        Codebooks.from_arrays({name: a for name, a in small_books().to_arrays().items() if name != "micro_folds"})


def test_folding_adds_every_entry_with_its_signs_to_its_places() -> None:
    vector, mean = np.array([2, 3, 5, 7], np.float32), np.ones(4, np.float32)
    # centred (1, 2, 4, 6): place 1 gets 1 - 6 - 4, place 2 gets -2 + 1 + 6, place 3 gets 4 + 2
    expected = np.array([-9, 5, 6]) / np.sqrt(142)
    np.testing.assert_allclose(fold(vector, mean, small_books().macro_folds), expected, atol=1e-6)


def test_folding_keeps_cosines_within_the_noise_of_its_length() -> None:
    rng = np.random.default_rng(0)
    folds = random_folds(4000, 800, rng)
    one, other = rng.normal(size=(2, 4000)).astype(np.float32)
    for share in (0.0, 0.5, 0.9):
        mixed = (share * one + np.sqrt(1 - share**2) * other).astype(np.float32)
        true = one @ mixed / np.linalg.norm(one) / np.linalg.norm(mixed)
        zero = np.zeros(4000, np.float32)
        assert abs(fold(one, zero, folds) @ fold(mixed, zero, folds) - true) < 4 / np.sqrt(800)


def test_discriminant_directions_ignore_what_differs_between_visits() -> None:
    rng = np.random.default_rng(1)
    places, visits = rng.normal(size=(60, 1, 3)), rng.normal(size=(60, 3, 3))
    vectors = np.concatenate([np.repeat(places, 3, axis=1) + 0.05 * visits, 5.0 * visits[:, :, :1]], axis=2)
    mean, basis = discriminant_directions(vectors, 3)
    projected = (vectors - mean) @ basis.T
    within = (projected - projected.mean(axis=1, keepdims=True)).var()
    raw_within = (vectors - vectors.mean(axis=1, keepdims=True)).var() / vectors.var()
    assert within / projected.var() < 0.1 * raw_within
