"""Unit vectors as two small integers."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.geometry import octahedral


@pytest.mark.parametrize("steps", [63, 127])
def test_every_direction_comes_back_within_about_two_steps(steps):
    vectors = np.random.default_rng(0).normal(size=(5000, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    codes = octahedral.encode(vectors, steps)
    angle = np.arccos(np.clip(np.sum(octahedral.decode(codes, steps) * vectors, axis=1), -1, 1))
    assert codes.max() <= 2 * steps
    assert angle.max() < 2.1 / steps


def test_the_axes_are_exact_and_codes_are_stable():
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    codes = octahedral.encode(axes, 127)
    assert np.allclose(octahedral.decode(codes, 127), axes)
    assert np.array_equal(octahedral.encode(octahedral.decode(codes, 127), 127), codes)


def test_listed_directions_are_those_of_the_formula():
    codes = np.stack(np.meshgrid(np.arange(31), np.arange(31), indexing="ij"), axis=-1).reshape(-1, 2)
    assert np.array_equal(octahedral.decode(codes, 15), octahedral._decoded(codes, 15))
