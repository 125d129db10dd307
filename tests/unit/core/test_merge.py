"""Merging neural maps of scenes that are known in closed form: surface, size, and what is refused."""

from __future__ import annotations

import dataclasses
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest

from revisit.cli import map_files
from revisit.cli.map_files import PlacedSubmap
from revisit.core.config import ImplicitMapConfig, SurfaceConfig
from revisit.core.errors import BadField, DescriptorModelMismatch
from revisit.core.geometry import se3
from revisit.core.implicit_map import NeuralMap, fit_implicit_map
from revisit.core.merge.evidence import ChangeKind, JoiningLoops, MergeRefusal, loops_refusal, surfaces_refusal
from revisit.core.merge.fused import PlacedMap, merge_neural_maps
from revisit.core.merge.history import changes_between
from revisit.core.merge.overlap import compare_pairs
from revisit.core.model_bundle import load_packaged_models
from revisit.core.profiles import Profile, profile_config, profile_models
from revisit.core.submap import Submap
from revisit.core.surface import extract_surface
from tests.support.decoders import planes_alone

HEIGHT = 1.7
TURNED = se3.from_yaw(0.9, (2.2, -1.3, 0.0))
"""Where the second submap's own frame lies in that of the first."""


@pytest.fixture
def scene(shapes):
    return [
        shapes["ground"](), shapes["box"]((9, -8, 0), (11, 8, 4)), shapes["sphere"]((-4.0, 9.0, 1.5), 3.0),
        shapes["box"]((-14, -12, 0), (-6, -8, 6)),
    ]  # fmt: skip


_FITTED: list[tuple[PlacedMap, PlacedMap]] = []


@pytest.fixture
def pair(make_drive, scene):
    """Two drives through one scene, fitted once; the frame of the second one is turned and moved."""
    if not _FITTED:
        _FITTED.append(_two_drives(make_drive, scene))
    return _FITTED[0]


def _two_drives(make_drive, scene):
    first, second = (make_drive(lambda _: scene, step=step) for step in (1.5, 1.3))
    return PlacedMap(_fitted(first), np.eye(4)), PlacedMap(_fitted(_turned(second, TURNED)), TURNED)


def _fitted(submap: Submap) -> NeuralMap:
    return fit_implicit_map(submap, load_packaged_models().decoder, ImplicitMapConfig(), np.random.default_rng(0))


def _turned(submap: Submap, T: np.ndarray) -> Submap:
    """The same submap in a frame that lies at T in its own."""
    T_inverse = se3.inverse(T)

    def moved(points: np.ndarray) -> np.ndarray:
        return (points @ T_inverse[:3, :3].T + T_inverse[:3, 3]).astype(np.float32)

    return dataclasses.replace(submap, points=moved(submap.points), origins=moved(submap.origins))


def _true_distance(points: np.ndarray) -> np.ndarray:
    """Distance (n,) of points (n, 3) near the wall, the ball or the open ground from the scene's surfaces."""
    world = points + [0.0, 0.0, HEIGHT]
    inside = np.maximum(np.array([9, -8, -1]) - world, world - np.array([11, 8, 4]))
    other = np.maximum(np.array([-14, -12, -1]) - world, world - np.array([-6, -8, 6]))
    boxes = [np.linalg.norm(np.maximum(one, 0), axis=1) + np.minimum(one.max(axis=1), 0) for one in (inside, other)]
    ball = np.linalg.norm(world - [-4.0, 9.0, 1.5], axis=1) - 3.0
    return np.abs(np.min([world[:, 2], *boxes, ball], axis=0))


def _surface_error(field: NeuralMap) -> float:
    vertices = extract_surface(field, SurfaceConfig()).vertices
    near = np.linalg.norm(vertices, axis=1) < 14.0
    return float(_true_distance(vertices[near]).mean())


def test_a_merged_surface_is_as_true_as_an_unmerged_one_and_takes_little_more_room(pair):
    first, second = pair
    merged = merge_neural_maps(pair)
    assert _surface_error(merged) <= 1.2 * _surface_error(first.neural_map)
    assert len(merged.points) <= 0.6 * (len(first.neural_map.points) + len(second.neural_map.points))
    # Turned points no longer lie in rows, so that each takes more bytes than in the maps it comes from.
    assert len(merged.to_blob()) <= 0.75 * (len(first.neural_map.to_blob()) + len(second.neural_map.to_blob()))


def test_the_merged_field_is_stored_and_answers_for_distances(pair):
    merged = merge_neural_maps(pair)
    stored = NeuralMap.from_blob(merged.to_blob(), merged.decoder, merged.config)
    rng = np.random.default_rng(1)
    height = rng.uniform(-0.3, 0.4, 1000)
    queries = np.stack([rng.uniform(-6, 6, 1000), rng.uniform(-5, 5, 1000), height - HEIGHT], axis=1).astype(np.float32)
    for field in (merged, stored):
        distance, nearest = field.sdf(queries)
        seen = np.isfinite(nearest)
        assert seen.mean() > 0.95
        assert np.median(np.abs(distance - height)[seen]) < 0.04


def test_merging_two_streets_keeps_both(make_drive, scene):
    one = _fitted(make_drive(lambda _: scene))
    away = se3.from_yaw(0.5, (500.0, 20.0, 3.0))
    merged = merge_neural_maps([PlacedMap(one, np.eye(4)), PlacedMap(one, away)])
    assert len(merged.points) == pytest.approx(2 * len(one.points), rel=0.12)
    far = merged.points.positions[merged.points.positions[:, 0] > 250.0]
    assert len(far) == pytest.approx(len(one.points), rel=0.12)  # two turned points may share a voxel


def test_a_mesh_of_a_map_in_utm_is_as_fine_as_one_at_the_origin(pair, monkeypatch):
    blobs = {str(number): one.neural_map.to_blob() for number, one in enumerate(pair)}
    client = SimpleNamespace(download=lambda name, kind: blobs[name])
    monkeypatch.setattr(map_files, "Client", lambda http: nullcontext(client))
    moved = se3.from_yaw(0.0, (500123.0, 5400321.0, 110.0))
    here, there = (
        map_files.merged_mesh(
            "", [PlacedSubmap(str(number), 0, T @ one.T_map_submap) for number, one in enumerate(pair)], lambda *_: None
        )
        for T in (np.eye(4), moved)
    )
    np.testing.assert_allclose(there[0] - moved[:3, 3], here[0], rtol=0, atol=1e-6)
    np.testing.assert_array_equal(there[2], here[2])


def test_learned_maps_with_decoders_of_their_own_become_one_learned_map(make_drive, scene):
    rules, models = profile_config(Profile.PAPER).implicit_map, profile_models(Profile.PAPER)
    placed = [
        PlacedMap(fit_implicit_map(drive, models.decoder, rules, np.random.default_rng(0)), np.eye(4))
        for drive in (make_drive(lambda _: scene, step=step, scans=4) for step in (1.5, 1.3))
    ]
    assert len({one.neural_map.decoder.digest for one in placed}) == 2
    merged = merge_neural_maps(placed)
    stored = NeuralMap.from_blob(merged.to_blob(), planes_alone(), ImplicitMapConfig())
    assert stored.decoder.digest == merged.decoder.digest == merge_neural_maps(placed[::-1]).decoder.digest
    assert _surface_error(stored) <= 1.2 * max(_surface_error(one.neural_map) for one in placed)


def test_maps_of_different_kinds_or_resolutions_are_not_merged(pair):
    first, second = pair
    other = dataclasses.replace(second.neural_map, decoder=planes_alone())
    with pytest.raises(DescriptorModelMismatch):
        merge_neural_maps([first, dataclasses.replace(second, neural_map=other)])
    coarse = dataclasses.replace(second.neural_map, config=ImplicitMapConfig(resolution=0.5))
    with pytest.raises(BadField):
        merge_neural_maps([first, dataclasses.replace(second, neural_map=coarse)])
    with pytest.raises(BadField):
        merge_neural_maps([])


def test_surfaces_of_a_right_alignment_agree_and_those_of_a_wrong_one_do_not(pair):
    first, second = pair
    right = compare_pairs([(first, second)])
    assert right.common_points > 5_000
    assert right.residual_m < 0.05
    assert surfaces_refusal(right) is None
    for error in (se3.from_yaw(0.0, (3.0, 1.0, 0.0)), se3.from_yaw(np.pi, (0.0, 0.0, 0.0))):
        wrong = compare_pairs([(first, PlacedMap(second.neural_map, error @ second.T_map_submap))])
        assert surfaces_refusal(wrong) is not None, wrong


def test_groups_that_share_nothing_are_refused_for_their_overlap(pair):
    first, second = pair
    apart = PlacedMap(second.neural_map, se3.from_yaw(0.0, (300.0, 0.0, 0.0)))
    evidence = compare_pairs([(first, apart)])
    assert evidence.common_points == 0
    assert surfaces_refusal(evidence) is MergeRefusal.OVERLAP_TOO_SMALL


@pytest.mark.parametrize(
    ("loops", "track_m", "rivals", "reason"),
    [
        (2, 30.0, 0, MergeRefusal.TOO_FEW_LOOPS),
        (5, 3.0, 0, MergeRefusal.COMMON_TRACK_TOO_SHORT),
        (6, 30.0, 3, MergeRefusal.ALIGNMENTS_COMPETE),
        (9, 30.0, 2, None),
    ],
)
def test_too_little_evidence_is_named(loops, track_m, rivals, reason):
    assert loops_refusal(JoiningLoops(loops, track_m, rivals)) is reason


def test_a_box_of_one_day_alone_is_a_change(make_drive, shapes):
    ground = shapes["ground"]()
    wall, car = shapes["box"]((-6, 12, 0), (14, 13, 4)), shapes["box"]((2, 6, 0), (6, 8, 1.6))
    without, with_it = (
        PlacedMap(_fitted(make_drive(lambda _, s=s: s, step=1.5)), np.eye(4))
        for s in ([ground, wall], [ground, wall, car])
    )
    (gone,) = changes_between([(with_it, without)])
    assert gone.kind == ChangeKind.VANISHED
    low, high = (
        np.array(gone.centre_m) - np.array(gone.extent_m) / 2,
        np.array(gone.centre_m) + np.array(gone.extent_m) / 2,
    )
    assert (low[:2] > [1.5, 5.5]).all() and (high[:2] < [6.5, 8.5]).all()
    (new,) = changes_between([(without, with_it)])
    assert (new.kind, new.points) == (ChangeKind.APPEARED, gone.points)
    assert changes_between([(without, without)]) == []
