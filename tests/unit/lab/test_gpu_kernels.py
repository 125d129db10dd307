"""Kernels of description by torch give what the compiled ones give; what is no device is named."""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module

import numpy as np
import pytest

from lab.gpu.compiled import compiled_description
from lab.gpu.kernels import Cases, DescriptionKernels, FieldRules, Patches, Planes, Returns
from lab.gpu.on_torch import find_torch_device, torch_description
from revisit.core.kernels.elastic_points import SCANS
from revisit.core.surface.marching_cubes import case_table, edge_table

torch = pytest.importorskip("torch", reason="devices but the processor need torch")

DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
RULES = FieldRules(neighbours=6, rings=2, power=2.0)
EDGE = 0.4
COMPILED = compiled_description()


@pytest.fixture(params=DEVICES)
def torches(request) -> DescriptionKernels:
    """The kernels of each device of torch that is here."""
    return torch_description(find_torch_device(request.param))


def returns(seed: int = 1) -> Returns:
    """Returns of three scans on a floor and a wall, some voxels with many, some with one."""
    rng = np.random.default_rng(seed)
    floor = np.column_stack([rng.normal(0.0, 6.0, (3_000, 2)), rng.normal(0.0, 0.02, 3_000)])
    wall = np.column_stack([np.full(1_500, 5.03), rng.uniform(-8.0, 8.0, 1_500), rng.uniform(0.0, 3.0, 1_500)])
    points = np.concatenate([floor, wall, rng.uniform(-40.0, 40.0, (100, 3))])[rng.permutation(4_600)]
    origins = np.array([[0.0, 0.0, 1.7], [1.0, 0.1, 1.7], [2.0, 0.0, 1.7]], np.float32)
    return Returns(points.astype(np.float32), np.array([0, 1_500, 1_500, 4_600]), origins)


@lru_cache(maxsize=1)
def planes() -> Planes:
    """Tangent planes of made-up returns."""
    gathered = COMPILED.maps.gather(returns(), EDGE, 10_000)
    positions = (gathered[:, 1:4] / gathered[:, :1]).astype(np.float32)
    bare = Planes(positions, np.zeros_like(positions), EDGE)
    return Planes(positions, COMPILED.maps.orient(positions, gathered, bare, gathered), EDGE)


@pytest.mark.parametrize(
    ("steps", "columns", "constants"),
    [
        ("normals._oriented", ((3, 3), (3,)), {}),
        ("visibility.pixels_of", ((3,),), {}),
        ("maps._terms", ((3,), (3,)), {"resolution": 0.4}),
        ("maps._own_spreads", ((3,), (10,)), {}),
        ("maps._shares", ((3,), (7,)), {"resolution": 0.4}),
        ("maps._covariances", ((10,),), {}),
    ],
)
def test_what_is_recorded_for_more_rows_gives_those_that_there_are(steps, columns, constants):
    module, name = steps.split(".")
    work = getattr(import_module(f"lab.gpu.{module}"), name)
    rng = np.random.default_rng(3)
    given = [torch.as_tensor(rng.uniform(0.5, 2.0, (9, *shape))) for shape in columns]
    wider = [torch.cat([column, torch.ones_like(column)]) for column in given]
    for found, expected in zip(work(*wider, **constants), work(*given, **constants), strict=True):
        assert len(found) == 18 and expected.isfinite().all()
        torch.testing.assert_close(found[:9], expected, rtol=0.0, atol=0.0)


@pytest.mark.parametrize("limit", [10_000, 600])
def test_returns_are_gathered_in_the_order_of_the_loop(torches, limit):
    found, expected = (kernels.maps.gather(returns(), EDGE, limit) for kernels in (torches, COMPILED))
    assert found.shape == expected.shape and (limit > 600 or len(found) == 600)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-9)
    assert expected[:, SCANS].max() == 2  # the second scan has no returns


def test_normals_are_those_of_the_compiled_kernel(torches):
    gathered = COMPILED.maps.gather(returns(), EDGE, 10_000)
    some = np.arange(0, len(gathered), 2)
    bare = Planes(planes().positions, np.zeros_like(planes().positions), EDGE)
    found = torches.maps.orient(planes().positions[some], gathered[some], bare, gathered)
    np.testing.assert_allclose(found, planes().normals[some], atol=2e-6)


def test_positions_are_seen_through_by_the_same_scans(torches):
    positions = planes().positions + np.array([0.0, 0.0, 0.9], np.float32)
    found, expected = (kernels.maps.see_through(positions, returns()) for kernels in (torches, COMPILED))
    np.testing.assert_array_equal(found, expected)
    assert 0 < np.count_nonzero(expected) < len(expected)


def test_cells_and_their_mesh_come_in_the_order_of_the_loop(torches):
    found, expected = (kernels.surfaces.cells(planes(), 0.6) for kernels in (torches, COMPILED))
    np.testing.assert_array_equal(found.corners[found.cell_corners], expected.corners[expected.cell_corners])
    corners = (expected.corners * EDGE).astype(np.float32)
    values, nearest = COMPILED.surfaces.distances(corners, planes(), RULES)
    values[nearest > 0.5] = np.nan
    of_all = (expected.cell_corners, corners, values, Cases(case_table(), edge_table()), EDGE)
    for part, other in zip(torches.surfaces.polygonise(*of_all), COMPILED.surfaces.polygonise(*of_all), strict=True):
        np.testing.assert_array_equal(part, other)
    assert 0 < other.sum() < len(other)


@pytest.mark.parametrize("power", [1.0, 2.0, 3.0])
def test_the_field_around_planes_is_that_of_the_compiled_kernels(torches, power):
    rules, rng = RULES._replace(power=power), np.random.default_rng(5)
    beside = planes().positions + rng.normal(0.0, 0.3, planes().positions.shape)
    queries = np.concatenate([beside, rng.uniform(-900.0, 900.0, (50, 3))]).astype(np.float32)
    (found, gaps), (expected, nearest) = (
        kernels.surfaces.distances(queries, planes(), rules) for kernels in (torches, COMPILED)
    )
    np.testing.assert_array_equal(gaps, nearest)
    np.testing.assert_allclose(found, expected, atol=2e-6)
    normals = [kernels.surfaces.blended_normals(queries, planes(), rules) for kernels in (torches, COMPILED)]
    np.testing.assert_allclose(*normals, atol=1e-4)
    assert np.isinf(nearest).any() and np.isfinite(nearest).sum() > 1_000


def test_what_lies_near_is_what_the_compiled_kernel_finds(torches):
    rng = np.random.default_rng(6)
    queries = np.concatenate([rng.uniform(-8.0, 8.0, (2_000, 3)), [[900.0, 0.0, 0.0]]]).astype(np.float32)
    for distance in (0.5, 1.2):
        found, expected = (
            one.surfaces.any_within(queries, planes().positions, distance) for one in (torches, COMPILED)
        )
        np.testing.assert_array_equal(found, expected)
        assert 0 < expected.sum() < len(queries)
    corner = np.zeros((1, 3), np.float32)  # exactly as far as asked for
    assert torches.surfaces.any_within(corner, corner + np.array([0.5, 0.0, 0.0], np.float32), 0.5).all()


@pytest.mark.parametrize("reach", [4e5, 1e7])
def test_what_is_too_far_apart_for_keys_is_left_to_the_compiled_kernels(torches, reach):
    ends = np.array([[-1, -1, -1], [1, 1, 1], [1, -1, 1], [0.1, 0.1, 0.1]], np.float32) * np.float32(reach)
    far = Returns(ends, np.array([0, 4]), np.zeros((1, 3), np.float32))
    gathered = torches.maps.gather(far, EDGE, 100)
    np.testing.assert_allclose(gathered, COMPILED.maps.gather(far, EDGE, 100), rtol=1e-9)
    apart = Planes(ends, np.tile(np.array([0, 0, 1], np.float32), (4, 1)), EDGE)
    np.testing.assert_array_equal(
        torches.surfaces.distances(ends, apart, RULES), COMPILED.surfaces.distances(ends, apart, RULES)
    )
    assert len(torches.surfaces.cells(apart, 0.6).cell_corners) == len(COMPILED.surfaces.cells(apart, 0.6).cell_corners)


def test_nothing_has_no_surface_and_no_profile(torches):
    none = Planes(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), EDGE)
    nowhere = Returns(np.zeros((0, 3), np.float32), np.zeros(2, np.int64), np.zeros((1, 3), np.float32))
    assert torches.maps.gather(nowhere, EDGE, 10).shape == (0, SCANS + 1)
    assert torches.surfaces.cells(none, 0.6).cell_corners.shape == (0, 8)
    assert not torches.surfaces.any_within(planes().positions, none.positions, 0.5).any()
    assert not torches.views.plans(np.zeros((0, 2)), np.zeros(0), (12, 40), 1.0).any()
    assert not torches.views.faces(np.zeros((0, 2)), np.zeros(0), np.zeros(0), (12, 40), 1.0, 4.0).any()


def test_profiles_are_those_of_the_compiled_kernels(torches):
    rng = np.random.default_rng(2)
    places, heading = rng.uniform(-25.0, 25.0, (400, 2)), rng.uniform(-np.pi, np.pi, 400)
    weight = np.clip(rng.uniform(-0.2, 1.0, 400), 0.0, 1.0)
    both = torches, COMPILED
    for sharpness in (4.0, 2.5):
        faces = [one.views.faces(places, heading, weight, (72, 40), 1.0, sharpness) for one in both]
        np.testing.assert_allclose(*faces, atol=1e-9)
    np.testing.assert_allclose(
        *(one.views.plans(places, weight, (72, 40), 1.0) for one in (torches, COMPILED)), atol=1e-9
    )


def test_histograms_and_filters_of_a_plan_are_those_of_the_compiled_kernels(torches):
    rng = np.random.default_rng(3)
    image = np.kron(rng.random((12, 12)) > 0.7, np.ones((8, 8))).astype(np.float32)
    bank = rng.random((6, 4, 108, 108)).astype(np.float32)
    (index, amplitude), (expected, level) = (
        one.views.strongest_orientations(image, bank) for one in (torches, COMPILED)
    )
    np.testing.assert_allclose(amplitude, level, rtol=1e-4)
    assert (index != expected).mean() < 1e-3
    pixels, form = rng.integers(0, 96, (30, 2)), Patches(24, 2, 3, 6)
    angles = rng.uniform(0.0, np.pi, 30).astype(np.float32)
    found = [one.views.patches(expected, level, pixels, angles, form) for one in (torches, COMPILED)]
    np.testing.assert_allclose(*found, rtol=1e-4, atol=1e-4 * level.max())
    layers, disc = rng.random((6, 96, 96)).astype(np.float32), rng.random((9, 9)).astype(np.float32)
    np.testing.assert_allclose(*(one.views.discs(layers, pixels, disc) for one in (torches, COMPILED)), rtol=1e-4)


@pytest.mark.parametrize("name", ["gpu", "cuda:99", "mps", "meta", ""])
def test_what_is_no_device_of_torch_here_is_refused(name):
    with pytest.raises(ValueError, match=r"cpu, cuda, cuda:N|such devices"):
        find_torch_device(name)
