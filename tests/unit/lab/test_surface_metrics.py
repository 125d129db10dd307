"""Errors of surfaces that are off by a known distance, and of the stored map of a wall."""

from __future__ import annotations

import numpy as np
import pytest

from lab.surfaces import kinds
from revisit.evaluation.surfaces.bench import measure
from revisit.evaluation.surfaces.metrics import CUT_M, HeldOutReturns, TrueTriangles, mean_error, surface_error
from revisit.evaluation.surfaces.scenes import walls
from revisit.evaluation.surfaces.zero_level import Mesh


def square(height: float, reach: float = 4.0, first: float = -4.0) -> Mesh:
    """A level square from `first` to `reach` along x."""
    vertices = [[first, -4, height], [reach, -4, height], [reach, 4, height], [first, 4, height]]
    return Mesh(np.array(vertices, np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def true_square(seed: int = 0) -> TrueTriangles:
    mesh = square(0.0)
    on = np.random.default_rng(seed).uniform(-4, 4, (20_000, 3)).astype(np.float32) * [1, 1, 0]
    return TrueTriangles(mesh.vertices[mesh.faces], on.astype(np.float32))


def test_a_surface_seven_centimetres_off_is_seven_centimetres_off_both_ways():
    error = surface_error(square(0.07), true_square())
    assert error.accuracy == pytest.approx(0.07, abs=1e-4)
    assert error.completeness == pytest.approx(0.07, abs=1e-4)
    assert error.f_score == pytest.approx((0.0, 1.0, 1.0))
    assert error.normal_deg < 0.1


def test_a_surface_of_which_half_is_missing_is_accurate_and_incomplete():
    error = surface_error(square(0.0, reach=0.0), true_square())
    assert error.accuracy == pytest.approx(0.0, abs=1e-4)
    assert error.recall[0] == pytest.approx(0.5, abs=0.03)
    assert error.completeness > 0.15


def test_a_surface_that_is_not_there_lowers_precision():
    error = surface_error(square(0.0, reach=12.0), true_square())
    assert error.precision[0] == pytest.approx(0.5, abs=0.03)
    assert error.accuracy == pytest.approx(0.5 * CUT_M, rel=0.05)
    assert error.recall == (1.0, 1.0, 1.0)


def test_where_no_return_was_held_out_nothing_is_said():
    truth = HeldOutReturns(true_square().samples)
    error = surface_error(square(0.02, reach=12.0), truth)
    assert error.accuracy == pytest.approx(0.02, abs=1e-3)
    assert error.precision[0] == pytest.approx(1.0)


def test_lengths_of_a_small_room_are_given_in_metres():
    error = surface_error(square(0.07), true_square(), unit_m=0.25)
    assert error.accuracy == pytest.approx(0.0175, abs=1e-4)


def test_the_mean_of_errors_is_that_of_each_figure():
    one, other = surface_error(square(0.02), true_square()), surface_error(square(0.08), true_square())
    assert mean_error([one, other]).mean == pytest.approx(0.05, abs=1e-3)


def test_stored_planes_of_noisy_walls_are_nearer_to_them_than_a_learned_field():
    planes = measure("walls", "planes", [walls()], kinds.PLANES)
    learned = measure("walls", "learned", [walls()], kinds.LEARNED)
    assert planes.error.accuracy_median < 0.007 < learned.error.accuracy_median
    assert planes.kilobytes < 0.6 * learned.kilobytes
    table = kinds.kinds_table([planes, learned])
    assert f"{100 * planes.share:.2f} %" in table and table.count("\n") == 4
