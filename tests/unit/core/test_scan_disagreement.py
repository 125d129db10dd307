"""How far the scans of a submap disagree: what no motion mends, and a sensor that looks beside its way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from revisit.core.config import SubmapConfig
from revisit.core.geometry import se3
from revisit.core.kernels.drawn_columns import points_of_drawn_columns
from revisit.core.odometry_bend import odometry_bend
from revisit.core.scan import Scan
from revisit.core.scan_disagreement import ScanDisagreement, scan_disagreement
from revisit.core.scan_planes import seen_cubes
from revisit.core.submap import Submap

NOISE_M = 0.01


def street(rng: np.random.Generator, count: int = 9_000) -> np.ndarray:
    """Points (n, 3) on the ground, on two rows of houses with gaps, and on walls across the gaps."""
    along, up = rng.uniform(-25.0, 25.0, count), rng.uniform(0.0, 5.0, count)
    ground = np.column_stack([along, rng.uniform(-8.0, 8.0, count), np.zeros(count)])
    fronts = np.column_stack([along, 8.0 * rng.choice([-1.0, 1.0], count), up])
    ends = np.column_stack([rng.choice([-15.0, -4.0, 7.0, 18.0], count), rng.uniform(8.0, 14.0, count), up])
    return np.concatenate([ground, fronts, ends])


def driven(
    askew_deg: float = 0.0,
    uneven_m: float = 0.0,
    jitter_m: float = 0.0,
    jitter_deg: float = 0.0,
    *,
    step_m: float = 2.0,
    bow_deg: float = 0.0,
    veer_deg: float = 0.0,
) -> Submap:
    """Scans over 8 m along x: the sensor is turned aside, ranges are wrong by its own angles, poses are jittery.

    The recorded heading bows by `bow_deg` to one side in the middle, and veers by `veer_deg` from start to end.
    """  # fmt: skip
    rng, scans = np.random.default_rng(4), []
    T_mount = se3.from_yaw(np.radians(askew_deg))
    for x in np.arange(-4.0, 4.1, step_m).tolist():
        seen = street(rng) - [x, 0.0, 1.6]
        seen += rng.normal(0.0, NOISE_M, seen.shape)
        distance = np.linalg.norm(seen, axis=1, keepdims=True)
        beam = np.sin(9.0 * np.arctan2(seen[:, 1:2], seen[:, :1]))
        points = se3.apply(se3.inverse(T_mount), seen * (1.0 + uneven_m * beam / distance))
        off = se3.exp(np.concatenate([rng.normal(0.0, jitter_m, 3), np.radians(rng.normal(0.0, jitter_deg, 3))]))
        heading = bow_deg * np.cos(np.pi * x / 8.0) + veer_deg * x / 8.0
        pose = se3.from_yaw(np.radians(heading), (x, 0.0, 1.6)) @ off
        scans.append(Scan.validated(points.astype(np.float32), pose, int(1e9 * (x + 9))))
    return Submap.from_scans(scans, SubmapConfig())


def told(submap: Submap) -> ScanDisagreement:
    found = scan_disagreement(submap.levelled())
    assert found is not None
    return found


def test_scans_that_see_the_same_planes_agree() -> None:
    found = told(driven())
    assert found.surface < 0.002
    assert np.degrees(found.askew) < 0.05


def test_little_counts_of_what_poses_are_off_by_and_more_where_they_are_off_by_much() -> None:
    usual, bad = told(driven(jitter_m=0.01)), told(driven(jitter_m=0.06))
    assert usual.surface < 0.004
    assert bad.surface > 2.0 * usual.surface


def test_what_the_pose_of_one_scan_is_off_by_is_told_along_and_about_the_axes() -> None:
    exact, shifted, turned = told(driven()), told(driven(jitter_m=0.03)), told(driven(jitter_deg=0.3))
    assert exact.shift < 0.001 and np.degrees(exact.turn) < 0.01
    assert 0.01 < shifted.shift < 0.06 and np.degrees(shifted.turn) < 0.05
    assert 0.1 < np.degrees(turned.turn) < 0.6 and turned.shift < 0.01


def test_a_heading_that_bends_along_many_scans_counts_and_a_steady_drift_does_not() -> None:
    exact, bent, veering = (told(driven(step_m=0.5, **how)) for how in ({}, {"bow_deg": 0.3}, {"veer_deg": 0.3}))
    off = 0.3 * np.std(np.cos(np.pi * np.arange(-4.0, 4.1, 0.5) / 8.0)) / np.sqrt(3.0)  # of three axes one bends
    assert np.degrees(exact.turn) < 0.01 and np.degrees(veering.turn) < 0.3 * off
    assert np.degrees(bent.turn) == pytest.approx(off, rel=0.3)


def test_planes_near_the_sensor_alone_tell_nothing_of_a_place() -> None:
    submap = driven()
    near = np.linalg.norm(submap.points[:, :2], axis=1) < 7.0
    assert near.sum() > 5_000
    assert scan_disagreement(replace(submap, points=submap.points[near], scan_index=submap.scan_index[near])) is None


def test_a_sensor_that_looks_beside_its_way_is_told_by_its_angle() -> None:
    found = told(driven(askew_deg=0.5))
    assert np.degrees(found.askew) == pytest.approx(0.5, abs=0.05)
    assert found.surface < 0.002


def test_what_no_motion_of_the_scans_mends_is_left() -> None:
    assert told(driven(uneven_m=0.08)).surface > 0.008


def test_the_order_of_the_axes_does_not_matter() -> None:
    submap = driven(askew_deg=0.5)
    turned = Submap.accumulated(
        [Scan.validated(submap.points[submap.scan_index == s], se3.from_yaw(0.7), s + 1) for s in range(5)],
        np.eye(4), SubmapConfig(), len(submap.points),
    )  # fmt: skip
    origins = se3.apply(se3.from_yaw(0.7), submap.origins).astype(np.float32)
    turned = Submap(turned.points, turned.scan_index, origins, turned.stamps_ns, np.eye(4), turned.position)
    assert told(turned).askew == pytest.approx(told(submap).askew, abs=np.radians(0.05))


def test_columns_are_drawn_whole_and_about_as_many_points_as_wanted() -> None:
    points = np.random.default_rng(1).uniform(-40.0, 40.0, (40_000, 3)).astype(np.float32)
    near = np.flatnonzero((np.abs(points[:, :2]) < 30.0).all(axis=1))
    np.testing.assert_array_equal(points_of_drawn_columns(points, 30.0, 50_000), near)
    rows = points_of_drawn_columns(points, 30.0, 5_000)
    assert 4_000 < len(rows) < 6_000
    drawn, others = (np.floor(points[some, :2]) for some in (rows, np.setdiff1d(near, rows)))
    assert not {tuple(one) for one in drawn.tolist()} & {tuple(one) for one in others.tolist()}


def test_one_cloud_and_few_points_tell_nothing() -> None:
    scan = Scan.validated(street(np.random.default_rng(0)).astype(np.float32), np.eye(4), 1)
    assert scan_disagreement(Submap.from_cloud(scan)) is None
    thin = [Scan.validated(street(np.random.default_rng(k), 60).astype(np.float32), np.eye(4), k + 1) for k in range(3)]
    assert (
        scan_disagreement(Submap.accumulated(thin, np.eye(4), SubmapConfig(), sum(len(one.points) for one in thin)))
        is None
    )


def test_cubes_that_are_at_hand_tell_what_is_told_without_them():
    submap = driven(jitter_m=0.01, jitter_deg=0.05, veer_deg=3.0, step_m=1.0).levelled()
    cubes, bend = seen_cubes(submap), odometry_bend(submap)
    assert cubes is not None and bend is not None
    assert scan_disagreement(submap, cubes) == scan_disagreement(submap) != scan_disagreement(bend.straightened(submap))
    found = odometry_bend(submap, cubes)
    assert found is not None and np.array_equal(found.turn, bend.turn) and np.array_equal(found.slip, bend.slip)
