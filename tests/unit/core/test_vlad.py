"""Aggregation and codebooks, by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.errors import DataLoss
from core.vlad import Codebooks, aggregate, reduce


def small_books() -> Codebooks:
    """Two principal components, two centres each."""
    identity, centres = np.eye(2, dtype=np.float32), np.array([[0, 0], [10, 0]], np.float32)
    four = np.eye(4, dtype=np.float32)
    zeros = np.zeros(4, np.float32)
    return Codebooks(identity, np.array([1, -1], np.float32), centres, zeros, four, centres, zeros, four)


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
    assert not reduce(nothing, np.ones(4, np.float32), np.eye(4, dtype=np.float32)).any()


def test_codebooks_survive_their_arrays() -> None:
    restored = Codebooks.from_arrays(small_books().to_arrays())
    for name, array in small_books().to_arrays().items():
        np.testing.assert_array_equal(getattr(restored, name), array)


def test_codebooks_whose_shapes_disagree_are_refused() -> None:
    with pytest.raises(DataLoss):
        Codebooks.from_arrays(replace(small_books(), macro_mean=np.zeros(3, np.float32)).to_arrays())
    with pytest.raises(DataLoss, match="micro_basis"):
        Codebooks.from_arrays({name: a for name, a in small_books().to_arrays().items() if name != "micro_basis"})
