"""The implicit map against surfaces known in closed form (paper III-B)."""

from __future__ import annotations

import dataclasses
import importlib
import subprocess
import sys

import numpy as np
import pytest

from revisit.core.codec import neural_map as codec
from revisit.core.config import Field, Fitting, ImplicitMapConfig, Loss, SurfaceConfig
from revisit.core.errors import DataLoss, DescriptorModelMismatch
from revisit.core.implicit_map import NeuralMap, fit_implicit_map
from revisit.core.implicit_map.decoder import orientations
from revisit.core.implicit_map.neural_points import oriented
from revisit.core.implicit_map.samples import draw_samples
from revisit.core.kernels.gathered_returns import GatheredReturns
from revisit.core.kernels.nearest_points import nearest_points
from revisit.core.kernels.point_columns import columns_of
from revisit.core.kernels.voxel_table import table_of, voxels_of
from revisit.core.model_bundle import load_packaged_models
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.core.surface import extract_surface
from tests.support.decoders import planes_alone

CONFIG = ImplicitMapConfig()
LEARNED = dataclasses.replace(CONFIG, field=Field.LEARNED, weight_power=1.0)
SENSOR_HEIGHT = 1.7


def fit(submap: Submap, config: ImplicitMapConfig = CONFIG) -> NeuralMap:
    return fit_implicit_map(submap, load_packaged_models().decoder, config, np.random.default_rng(0))


def near_wall(rng, count=2000):
    """Points before and behind the wall x = 10 of the box scene, in the frame of the submap, with their distances."""
    offset = rng.uniform(-0.25, 0.45, count)
    points = np.stack([10.0 - offset, rng.uniform(-4, 4, count), rng.uniform(0.6, 3.0, count) - SENSOR_HEIGHT], axis=1)
    return points.astype(np.float32), offset


def test_the_distance_to_flat_ground_is_right_within_three_centimetres(make_drive, shapes):
    field = fit(make_drive(lambda _: [shapes["ground"]()]))
    rng = np.random.default_rng(1)
    height = rng.uniform(-0.3, 0.45, 2000)
    queries = np.stack([rng.uniform(-8, 8, 2000), rng.uniform(-8, 8, 2000), height - SENSOR_HEIGHT], axis=1)
    distance, nearest = field.sdf(queries.astype(np.float32))
    assert np.isfinite(nearest).mean() > 0.95
    seen = np.isfinite(nearest)
    assert np.median(np.abs(distance - height)[seen]) < 0.03
    assert np.percentile(np.abs(distance - height)[seen], 95) < 0.08


def test_the_sign_separates_free_space_from_solid_at_a_wall(make_drive, shapes):
    field = fit(make_drive(lambda _: [shapes["ground"](), shapes["box"]((10, -6, 0), (12, 6, 5))]))
    queries, offset = near_wall(np.random.default_rng(2))
    distance, _ = field.sdf(queries)
    clear = np.abs(offset) > 0.1
    assert np.mean((distance > 0)[clear] == (offset > 0)[clear]) > 0.97
    assert np.median(np.abs(distance - offset)) < 0.04


def test_the_surface_of_a_ball_has_the_right_radius_and_normals(make_drive, shapes):
    centre = np.array([0.0, 9.0, 2.0])
    submap = make_drive(lambda _: [shapes["sphere"](tuple(centre), 4.0)])
    surface = extract_surface(fit(submap), SurfaceConfig())
    outward = surface.vertices - (centre - [0, 0, SENSOR_HEIGHT])
    radius = np.linalg.norm(outward, axis=1)
    angle = np.degrees(np.arccos(np.clip(np.sum(outward / radius[:, None] * surface.normals, axis=1), -1, 1)))
    assert len(surface.vertices) > 300
    assert np.median(np.abs(radius - 4.0)) < 0.03
    assert np.median(angle) < 4.0


def test_two_walls_meet_in_a_corner_without_a_phantom_surface(make_drive, shapes):
    walls = [shapes["ground"](), shapes["box"]((8, -9, 0), (9, 9, 4)), shapes["box"]((-9, 8, 0), (9, 9, 4))]
    surface = extract_surface(fit(make_drive(lambda _: walls)), SurfaceConfig())
    world = surface.vertices + [0, 0, SENSOR_HEIGHT]
    corner = world[(world[:, 0] > 4) & (world[:, 1] > 4) & (world[:, 2] > 0.5) & (world[:, 2] < 3.5)]
    to_walls = np.minimum(np.abs(corner[:, 0] - 8), np.abs(corner[:, 1] - 8))
    assert len(corner) > 120
    assert np.median(to_walls) < 0.03
    assert np.percentile(to_walls, 99) < 0.35


def test_a_moving_car_leaves_no_surface_and_a_parked_one_does(make_drive, shapes):
    def scene(i):
        moving = shapes["box"]((-9 + 3.0 * i, 4, 0.1), (-5 + 3.0 * i, 6, 1.6))
        parked = shapes["box"]((-2, -7, 0.1), (2, -5, 1.6))
        return [shapes["ground"](), moving, parked, shapes["box"]((-30, 12, 0), (30, 13, 5))]

    surface = extract_surface(fit(make_drive(scene)), SurfaceConfig())
    world = surface.vertices + [0, 0, SENSOR_HEIGHT]
    body = (world[:, 2] > 0.6) & (world[:, 2] < 1.8)
    on_lane = body & (world[:, 1] > 3.6) & (world[:, 1] < 6.4) & (np.abs(world[:, 0]) < 12)
    on_parked = body & (world[:, 1] > -7.4) & (world[:, 1] < -4.6) & (np.abs(world[:, 0]) < 2.4)
    assert on_parked.sum() > 60
    assert on_lane.sum() < 0.05 * on_parked.sum()


def test_a_quarter_of_the_returns_gives_nearly_the_same_field(make_drive, shapes):
    submap = make_drive(lambda _: [shapes["ground"](), shapes["box"]((10, -6, 0), (12, 6, 5))])
    kept = np.sort(np.random.default_rng(3).permutation(len(submap.points))[: len(submap.points) // 4])
    thinned = dataclasses.replace(submap, points=submap.points[kept], scan_index=submap.scan_index[kept])
    queries, _ = near_wall(np.random.default_rng(4))
    dense, sparse = fit(submap).sdf(queries)[0], fit(thinned).sdf(queries)[0]
    assert np.median(np.abs(dense - sparse)) < 0.03


def test_the_field_turns_with_the_submap(make_drive, shapes):
    submap = make_drive(lambda _: [shapes["ground"](), shapes["box"]((10, -6, 0), (12, 6, 5))])
    turn = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1]], dtype=np.float32)
    turned = dataclasses.replace(submap, points=submap.points @ turn.T, origins=submap.origins @ turn.T)
    queries, _ = near_wall(np.random.default_rng(5))
    difference = fit(submap).sdf(queries)[0] - fit(turned).sdf((queries @ turn.T).astype(np.float32))[0]
    assert np.median(np.abs(difference)) < 0.03


@pytest.mark.parametrize(("fitting", "loss"), [(Fitting.AT_ONCE, Loss.BCE), (Fitting.SCAN_BY_SCAN, Loss.L1)])
def test_gradient_steps_lower_the_loss_on_the_training_samples(fitting, loss, make_drive, shapes):
    import torch  # here: every process of the tests collects this file, and one runs it

    from revisit.core.implicit_map.gradient_steps import sdf_loss

    submap = make_drive(lambda _: [shapes["ground"](), shapes["sphere"]((0.0, 9.0, 2.0), 2.0)])
    losses = []
    for steps in (0, 4):
        field = fit(submap, dataclasses.replace(LEARNED, steps=steps, fitting=fitting, loss=loss))
        origins = submap.origins[submap.scan_index]
        table = table_of(voxels_of(field.points.positions, CONFIG.resolution))
        samples = draw_samples(submap.points, origins, field.points, table, CONFIG, np.random.default_rng(9))
        distance, nearest = field.sdf(samples.positions)
        known = np.isfinite(nearest)
        predicted, labels = torch.from_numpy(distance[known]), torch.from_numpy(samples.labels[known])
        losses.append(float(sdf_loss(predicted, labels, field.config)))
    assert losses[1] < 0.99 * losses[0]


def test_the_decoder_adapts_only_when_asked_to(make_drive, shapes):
    submap = make_drive(lambda _: [shapes["ground"]()])
    shipped = load_packaged_models().decoder
    assert fit(submap, LEARNED).decoder.digest == shipped.digest
    online = dataclasses.replace(LEARNED, update_decoder=True)
    assert fit(submap, online).decoder.digest != shipped.digest


def scans_of(submap: Submap, scans: list[int]) -> Submap:
    """The submap of only so many of its scans."""
    kept = np.isin(submap.scan_index, scans)
    index = np.searchsorted(scans, submap.scan_index[kept]).astype(np.int32)
    return dataclasses.replace(
        submap, points=submap.points[kept], scan_index=index, origins=submap.origins[scans],
        stamps_ns=submap.stamps_ns[scans],
    )  # fmt: skip


def test_one_scan_is_fitted_online_as_at_once(make_drive, shapes):
    submap = scans_of(make_drive(lambda _: [shapes["ground"](), shapes["box"]((10, -6, 0), (12, 6, 5))]), [0])
    adapting = dataclasses.replace(LEARNED, update_decoder=True)
    at_once, online = fit(submap, adapting), fit(submap, dataclasses.replace(adapting, fitting=Fitting.SCAN_BY_SCAN))
    assert np.abs(at_once.features).max() > 0.01
    assert np.array_equal(at_once.features, online.features)
    assert at_once.decoder.digest == online.decoder.digest


def test_a_scan_of_another_spot_leaves_the_features_of_the_first_alone(make_drive, shapes):
    online = dataclasses.replace(LEARNED, fitting=Fitting.SCAN_BY_SCAN)
    first = scans_of(make_drive(lambda _: [shapes["ground"](), shapes["box"]((10, -6, 0), (12, 6, 5))]), [0])
    away = np.array([500, 0, 0], np.float32)
    both = dataclasses.replace(
        first, points=np.concatenate([first.points, first.points + away]),
        scan_index=np.repeat(np.array([0, 1], np.int32), len(first.points)),
        origins=np.concatenate([first.origins, first.origins + away]), stamps_ns=np.arange(2),
    )  # fmt: skip
    alone, among = fit(first, online), fit(both, online)
    here = among.points.positions[:, 0] < 250
    assert np.array_equal(among.points.positions[here], alone.points.positions)
    assert np.array_equal(among.features[here], alone.features)
    assert np.abs(among.features[~here]).max() > 0.01


def test_every_scan_takes_its_steps_from_where_the_last_one_left(make_drive, shapes):
    submap = make_drive(lambda _: [shapes["ground"](), shapes["sphere"]((0.0, 9.0, 2.0), 2.0)])
    online = dataclasses.replace(LEARNED, fitting=Fitting.SCAN_BY_SCAN)
    sizes = [np.abs(fit(scans_of(submap, list(range(count))), online).features).mean() for count in (1, 2, 4)]
    assert sizes[0] < sizes[1] < sizes[2]


def test_nearest_neural_points_agree_with_brute_force():
    rng = np.random.default_rng(6)
    cells = np.unique(rng.integers(-10, 10, (2000, 3)), axis=0)
    positions = ((cells + rng.uniform(0.05, 0.95, cells.shape)) * 0.4).astype(np.float32)
    queries = rng.uniform(-3.5, 3.5, (500, 3)).astype(np.float32)
    indices, squared = nearest_points(queries, columns_of(positions, 0.4), 0.4, 6, 2)
    gaps = ((queries[:, None] - positions) ** 2).sum(axis=2)
    order = np.argsort(gaps, axis=1)[:, :6]
    expected = np.take_along_axis(gaps, order, axis=1)
    within = expected < 0.8**2
    assert within.sum() > 2000
    assert np.array_equal(np.where(within, order, -1), indices)
    assert np.allclose(squared[within], expected[within], atol=1e-5)


def test_a_neural_point_moves_to_the_mean_of_its_returns_and_remembers_when():
    accumulator = GatheredReturns(0.4, 3, 3)
    origin = np.zeros(3, dtype=np.float32)
    accumulator.insert(np.array([[1.0, 1.0, 1.0], [1.1, 1.0, 1.0]], dtype=np.float32), origin, 2)
    accumulator.insert(np.array([[1.1, 1.1, 1.0]], dtype=np.float32), origin, 5)
    points = oriented(accumulator.records, 0.4)
    assert np.allclose(points.positions, [[3.2 / 3, 3.1 / 3, 1.0]], atol=1e-6)
    assert (points.created[0], points.updated[0], points.hits[0]) == (2, 5, 2)


@pytest.mark.parametrize("normal", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.6, 0, 0.8), (-0.48, 0.6, 0.64)])
def test_a_local_frame_is_a_rotation_whose_third_axis_is_the_normal(normal):
    frame = orientations(np.array([normal], dtype=np.float32))[0]
    assert np.allclose(frame @ frame.T, np.eye(3), atol=1e-5)
    assert np.linalg.det(frame) == pytest.approx(1.0, abs=1e-5)
    assert np.allclose(frame[2], normal, atol=1e-5)


def test_a_stored_map_answers_as_the_fitted_one_within_two_centimetres(make_drive, shapes):
    field = fit(make_drive(lambda _: [shapes["ground"](), shapes["box"]((10, -6, 0), (12, 6, 5))]))
    stored = NeuralMap.from_blob(field.to_blob(), field.decoder, CONFIG)
    queries, _ = near_wall(np.random.default_rng(7))
    assert len(stored.points) == len(field.points)
    assert np.percentile(np.abs(stored.sdf(queries)[0] - field.sdf(queries)[0]), 95) < 0.02


def test_a_stored_map_of_planes_has_the_fitted_ones_surface_with_rounder_normals(make_drive, shapes):
    field = fit(make_drive(lambda _: [shapes["ground"](), shapes["box"]((10, -6, 0), (12, 6, 5))]))
    shipped = load_packaged_models().decoder
    stored = NeuralMap.from_blob(field.to_blob(), shipped, dataclasses.replace(LEARNED, weight_power=3.0))
    queries, _ = near_wall(np.random.default_rng(7))
    assert stored.decoder is None and stored.config == CONFIG
    assert np.array_equal(stored.stamps_ns, field.stamps_ns)
    off = np.abs(stored.sdf(queries)[0] - field.sdf(queries)[0])
    assert np.median(off) < 0.005 and np.percentile(off, 95) < 0.02


def test_planes_need_no_torch():
    code = "import sys, revisit.core.pipeline as _; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_learned_field_is_computed_alike_with_and_without_torch(make_drive, shapes):
    import torch

    from revisit.core.implicit_map.gradient_steps import predict, tensors_of

    submap = make_drive(lambda _: [shapes["ground"](), shapes["sphere"]((0.0, 9.0, 2.0), 2.0)])
    field = fit(submap, LEARNED)
    queries = submap.points[::50]
    near = field.neighbourhood(queries)
    by_torch = predict(tensors_of(field.decoder), torch.from_numpy(field.features), near).numpy()
    assert np.allclose(field.sdf(queries)[0], np.clip(by_torch, -0.6, 0.6), atol=1e-5)


def test_planes_of_a_wall_with_noise_lie_within_half_a_centimetre_of_it():
    rng = np.random.default_rng(0)
    wall = np.column_stack([10 + rng.normal(0, 0.02, 60_000), rng.uniform(-6, 6, 60_000), rng.uniform(-2, 3, 60_000)])
    field = fit(Submap.from_cloud(Scan.validated(wall.astype(np.float32), np.eye(4), 0)))
    queries = np.column_stack([np.full(500, 10.0), rng.uniform(-5, 5, 500), rng.uniform(-1, 2, 500)])
    assert np.median(np.abs(field.sdf(queries.astype(np.float32))[0])) < 0.005


def test_a_map_with_an_adapted_decoder_is_read_back_with_it(make_drive, shapes):
    shipped = load_packaged_models().decoder
    field = fit(make_drive(lambda _: [shapes["ground"]()]), dataclasses.replace(LEARNED, update_decoder=True))
    stored = NeuralMap.from_blob(field.to_blob(), shipped, CONFIG)
    assert stored.decoder.digest == field.decoder.digest != shipped.digest
    again = NeuralMap.from_blob(stored.to_blob(), shipped, CONFIG)
    queries = np.random.default_rng(3).uniform(-5, 5, (500, 3)).astype(np.float32) * [1, 1, 0.1] - [0, 0, SENSOR_HEIGHT]
    assert np.array_equal(stored.sdf(queries)[0], again.sdf(queries)[0])
    assert np.median(np.abs(stored.sdf(queries)[0] - field.sdf(queries)[0])) < 0.02


def test_a_map_with_the_shared_decoder_does_not_store_it(make_drive, shapes):
    submap = make_drive(lambda _: [shapes["ground"]()])
    adapted = fit(submap, dataclasses.replace(LEARNED, update_decoder=True))
    assert len(fit(submap, LEARNED).to_blob()) < len(adapted.to_blob()) - 4 * 32 * 17 // 2


def test_an_adapted_decoder_of_another_size_is_refused(make_drive, shapes):
    field = fit(make_drive(lambda _: [shapes["ground"]()]), dataclasses.replace(LEARNED, update_decoder=True))
    header, sections = codec.unpack(field.to_blob())
    for damage in ({"layers": [[32, 17]]}, {"decoder": "0" * 16}, {"layers": "many"}):
        changed = {name: value for name, value in {**header, **damage}.items() if name != "sections"}
        with pytest.raises((DataLoss, DescriptorModelMismatch)):
            NeuralMap.from_blob(codec.pack(changed, sections), field.decoder, CONFIG)


def test_a_stored_map_of_another_decoder_is_refused(make_drive, shapes):
    blob = fit(make_drive(lambda _: [shapes["ground"]()]), LEARNED).to_blob()
    with pytest.raises(DescriptorModelMismatch):
        NeuralMap.from_blob(blob, planes_alone(), CONFIG)


def test_every_flipped_or_missing_byte_of_a_stored_map_is_noticed(make_drive, shapes):
    field = fit(make_drive(lambda _: [shapes["ground"]()]))
    blob = field.to_blob()
    rng = np.random.default_rng(8)
    for position in rng.integers(0, len(blob), 50):
        damaged = bytearray(blob)
        damaged[position] ^= 1 << int(rng.integers(8))
        with pytest.raises(DataLoss):
            NeuralMap.from_blob(bytes(damaged), field.decoder, CONFIG)
    for size in (0, 4, 31, 40, len(blob) - 1):
        with pytest.raises(DataLoss):
            NeuralMap.from_blob(blob[:size], field.decoder, CONFIG)


def test_a_learned_field_without_torch_says_which_extra_brings_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    monkeypatch.delitem(sys.modules, "revisit.core.implicit_map.gradient_steps")
    with pytest.raises(ImportError, match=r"revisit-loops\[learned\]"):
        importlib.import_module("revisit.core.implicit_map.gradient_steps")
