"""Description on a device: torch makes of simulated scans what the compiled kernels make of them."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from importlib import import_module

import numpy as np
import pytest

from revisit.core.config import PipelineConfig, SubmapConfig
from revisit.core.device import CPU, TORCH_ON_CPU, Device, open_device, using
from revisit.core.device.compiled_description import compiled_description
from revisit.core.device.description import Cases, DescriptionKernels, FieldRules, Patches, Planes, Returns
from revisit.core.kernels.elastic_points import SCANS
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import DescribedPlace, describe, verify
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.core.surface.marching_cubes import case_table, edge_table
from revisit.core.verification import RejectedLoop, VerifiedLoop
from revisit.evaluation.simulator import OS1_64, VLP16, LidarModel, Path, build_city, drive, simulate

torch = pytest.importorskip("torch", reason="devices but the processor need torch")

CONFIG = PipelineConfig()
FEW_BEAMS, MANY_BEAMS = replace(VLP16, columns=300), replace(OS1_64, columns=128)
DEVICES = [TORCH_ON_CPU, *(["cuda"] if torch.cuda.is_available() else [])]
RULES = FieldRules(neighbours=6, rings=2, power=2.0)
EDGE = 0.4
COMPILED = compiled_description()


@lru_cache(maxsize=1)
def visits() -> list[Submap]:
    """A place in a simulated street and another one, by few beams; the place driven the other way, by many beams."""
    there, back = Path.through([[0, 0], [70, 0]]), Path.through([[70, 4], [0, 4]])
    world = build_city([Path.through([[-40, 2], [110, 2]])], seed=2, drive=there)
    of_ways = [(there, 4, FEW_BEAMS), (there, 19, FEW_BEAMS), (back, 19, MANY_BEAMS)]

    def submap(way: Path, first: int, sensor: LidarModel) -> Submap:
        trajectory, span = drive(way, world.ground, spacing_m=2.5), slice(first, first + 5)
        seen = replace(trajectory, T_world_sensor=trajectory.T_world_sensor[span], stamps_ns=trajectory.stamps_ns[span])
        scans = simulate(world, seen, sensor, seed=first)
        checked = [Scan.validated(scan.points, scan.T_world_sensor, scan.stamp_ns) for scan in scans]
        return Submap.from_scans(checked, SubmapConfig())

    return [submap(*parts) for parts in of_ways]


@lru_cache(maxsize=4)
def described(device: str) -> list[DescribedPlace]:
    """The visits, described on a device."""
    with using(open_device(device)):
        return [describe(submap, load_packaged_models(), CONFIG) for submap in visits()]


@pytest.fixture(params=DEVICES)
def torches(request) -> DescriptionKernels:
    """The kernels of each device of torch that is here."""
    return open_device(request.param).description


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


@pytest.mark.parametrize("name", DEVICES)
def test_a_device_describes_simulated_scans_as_the_processor_does(name):
    for found, expected in zip(described(name), described(CPU), strict=True):
        assert float(found.descriptor.vector @ expected.descriptor.vector) >= 0.9999
        assert len(found.neural_map.points) == len(expected.neural_map.points) > 3_000
        np.testing.assert_allclose(found.neural_map.points.positions, expected.neural_map.points.positions, atol=1e-3)
        assert found.flags == expected.flags


@pytest.mark.parametrize("name", DEVICES)
def test_places_described_on_a_device_get_the_verdicts_of_the_processor(name):
    def verdicts(device: str) -> list[VerifiedLoop | RejectedLoop]:
        place, *others = (one.place for one in described(device))
        return [verify(other, place, 0.9, CONFIG.verification) for other in others]

    elsewhere, again = verdicts(CPU)
    assert isinstance(elsewhere, RejectedLoop) and isinstance(again, VerifiedLoop)
    found = verdicts(name)
    assert isinstance(found[0], RejectedLoop) and found[0].reason == elsewhere.reason
    assert isinstance(found[1], VerifiedLoop)
    np.testing.assert_allclose(found[1].measurement.T_match_query, again.measurement.T_match_query, atol=0.01)


def test_the_same_submap_gives_the_same_bits_each_time():
    with using(open_device(TORCH_ON_CPU)):
        again = describe(visits()[0], load_packaged_models(), CONFIG)
    first = described(TORCH_ON_CPU)[0]
    assert again.descriptor.vector.tobytes() == first.descriptor.vector.tobytes()
    assert again.place.to_blob() == first.place.to_blob()
    assert again.neural_map.to_blob() == first.neural_map.to_blob()


@pytest.mark.parametrize(
    ("steps", "columns", "constants"),
    [
        ("torch_normals._oriented", ((3, 3), (3,)), {}),
        ("torch_visibility.pixels_of", ((3,),), {}),
        ("torch_maps._terms", ((3,), (3,)), {"resolution": 0.4}),
        ("torch_maps._own_spreads", ((3,), (10,)), {}),
        ("torch_maps._shares", ((3,), (7,)), {"resolution": 0.4}),
        ("torch_maps._covariances", ((10,),), {}),
    ],
)
def test_what_is_recorded_for_more_rows_gives_those_that_there_are(steps, columns, constants):
    module, name = steps.split(".")
    work = getattr(import_module(f"revisit.core.device.{module}"), name)
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


def test_the_kernels_of_the_device_in_use_are_called():
    class Refusing:
        def __getattr__(self, kernel):
            raise RuntimeError(f"{kernel} was asked for")

    asked = DescriptionKernels(Refusing(), Refusing(), Refusing())
    submap = visits()[0]
    with using(Device("refusing", asked)), pytest.raises(RuntimeError, match="gather"):
        describe(submap, load_packaged_models(), CONFIG)
