"""The vertical of a cloud that comes without gravity."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from revisit.core.geometry import se3, upright
from revisit.core.geometry.upright import estimate_up, surface_normals
from tests.support.real_data import needs_real_data, unpacked_drive

RNG = np.random.default_rng(6)


def plane(normal_axis: int, at: float, extent: float, count: int = 4000) -> np.ndarray:
    """Points of a square of 2 `extent` side, a centimetre thick, square to an axis."""
    points = RNG.uniform(-extent, extent, (count, 3))
    points[:, normal_axis] = at + RNG.normal(0, 0.01, count)
    return points


GROUND = plane(2, -1.7, 15.0, 20_000)
WALLS = np.concatenate([plane(0, 9.0, 6.0), plane(1, -7.0, 6.0), plane(1, 8.0, 6.0)])
BUSHES = RNG.uniform(-8, 8, (8000, 3))
TILTS = [(0.0, 0.0), (5.0, 40.0), (20.0, 130.0), (32.0, -70.0)]


def tilted(points: np.ndarray, degrees: float, towards: float) -> tuple[np.ndarray, np.ndarray]:
    """The points in a frame that is tilted, and the vertical in it."""
    angle, heading = np.radians([degrees, towards])
    turn = se3.exp([0.0, 0.0, 0.0, angle * np.cos(heading), angle * np.sin(heading), 0.0])
    return se3.apply(turn, points), turn[:3, 2]


@pytest.mark.parametrize("tilt", TILTS, ids=str)
@pytest.mark.parametrize("world", [[GROUND], [WALLS], [GROUND, WALLS, BUSHES]], ids=["ground", "walls", "all"])
def test_the_vertical_is_found_to_a_degree(world, tilt) -> None:
    points, up = tilted(np.concatenate(world), *tilt)
    found = estimate_up(points)
    assert found is not None
    assert np.degrees(np.arccos(np.clip(found.up @ up, -1, 1))) < 1.0
    assert found.tilt_rad == pytest.approx(np.radians(tilt[0]), abs=0.02)


@pytest.mark.parametrize("scale", [0.05, 1.0, 20.0])
def test_the_scale_of_the_scene_does_not_matter(scale) -> None:
    points, up = tilted(np.concatenate([GROUND, WALLS]), 15.0, 20.0)
    found = estimate_up(scale * points)
    assert found is not None and np.degrees(np.arccos(np.clip(found.up @ up, -1, 1))) < 1.0


def test_the_cloud_is_turned_upright_and_no_further() -> None:
    points, _ = tilted(np.concatenate([GROUND, WALLS]), 25.0, 60.0)
    found = estimate_up(points)
    assert found is not None
    levelled = se3.apply(found.T_level_cloud(), points)
    assert np.std(levelled[: len(GROUND), 2]) < 0.15
    assert se3.rotation_angle(found.T_level_cloud()) == pytest.approx(np.radians(25.0), abs=0.02)


def test_bushes_and_few_points_have_no_vertical() -> None:
    assert estimate_up(BUSHES) is None
    assert estimate_up(GROUND[:100]) is None
    assert estimate_up(np.zeros((0, 3))) is None
    assert estimate_up(np.ones((500, 3))) is None


def test_two_directions_that_do_equally_well_are_no_answer() -> None:
    roof, _ = tilted(GROUND, 25.0, 0.0)
    other, _ = tilted(GROUND, -25.0, 0.0)
    assert estimate_up(np.concatenate([roof, other])) is None


def test_the_same_cloud_has_the_same_vertical_again() -> None:
    points, _ = tilted(np.concatenate([GROUND, WALLS]), 10.0, 0.0)
    first, second = estimate_up(points), estimate_up(points)
    assert first is not None and second is not None and np.array_equal(first.up, second.up)


def test_normals_are_those_of_the_planes() -> None:
    normals = surface_normals(WALLS)
    assert len(normals) > 100
    assert (np.abs(normals).max(axis=1) > 0.99).mean() > 0.95


@pytest.mark.real_data
@needs_real_data
def test_single_scans_of_a_car_are_levelled_to_a_degree_and_a_half(tmp_path: Path) -> None:
    from revisit.evaluation.datasets import open_recording

    recording = open_recording(unpacked_drive(tmp_path, slice(0, 400, 50)))
    for index in range(len(recording)):
        scan = recording.scan(index)
        turn = se3.exp([0.0, 0.0, 0.0, 0.3 * np.cos(index), 0.3 * np.sin(index), 0.0])
        found = estimate_up(se3.apply(turn, scan.points))
        assert found is not None
        assert np.degrees(np.arccos(found.up @ turn[:3, :3] @ scan.T_odom_sensor[2, :3])) < 1.5


def test_directions_that_are_scored_some_at_once_are_scored_as_all_together() -> None:
    normals, directions = RNG.normal(size=(2, 70, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    cosines = np.abs(directions @ normals.T)
    level, square = np.exp((cosines**2 - 1.0) / (2.0 * 0.05**2)), np.exp(-(cosines**2) / (2.0 * 0.05**2))
    np.testing.assert_allclose(upright._scores(directions, normals), (level + square).mean(axis=1), rtol=1e-12)
