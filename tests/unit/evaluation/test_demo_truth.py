"""How found loops are judged: the demo must not be able to flatter itself."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.evaluation.demo import FoundLoop, Targets, TrueSubmap, compare
from revisit.evaluation.demo.drive import demo_drives, drifting

TARGETS = Targets(gap=2)


def submap(order: int, x: float, robot: str = "patrol", yaw: float = 0.0) -> TrueSubmap:
    pose = se3.from_yaw(yaw, (x, 0.0, 0.0))
    return TrueSubmap(f"s{order}", robot, order, pose[:3, 3], pose)


# Out to 60 m and back, one submap every 20 m: 3 stands where 2 was, but is too near in order; 4 and 5 are revisits.
DRIVE = {s.name: s for s in [submap(0, 0), submap(1, 20), submap(2, 40), submap(3, 41), submap(4, 21, yaw=np.pi),
                             submap(5, 1, yaw=np.pi)]}  # fmt: skip


def true_loop(query: str, match: str, off: tuple[float, ...] = (0, 0, 0, 0, 0, 0)) -> FoundLoop:
    T = se3.inverse(DRIVE[match].T_world_submap) @ DRIVE[query].T_world_submap
    return FoundLoop(query, match, T @ se3.exp(off))


def test_revisits_are_submaps_near_an_earlier_pass_beyond_the_gap() -> None:
    report = compare(DRIVE, [], TARGETS)
    assert report.revisits == 2 and report.missed == ("s4", "s5")
    assert report.found_share == 0.0 and not report.reached


def test_exact_loops_reach_the_targets_whichever_submap_asked() -> None:
    report = compare(DRIVE, [true_loop("s4", "s1"), true_loop("s0", "s5")], TARGETS)
    assert report.found_share == 1.0 and report.false_loops == 0 and report.missed == ()
    assert report.median_m < 1e-9 and report.median_deg < 1e-6 and report.reached


def test_a_loop_with_a_wrong_pose_is_false_even_between_near_submaps_and_finds_nothing() -> None:
    report = compare(DRIVE, [true_loop("s4", "s1"), true_loop("s5", "s0", (2.5, 0, 0, 0, 0, 0))], TARGETS)
    assert report.false_loops == 1 and report.missed == ("s5",) and not report.reached


def test_errors_are_metres_and_degrees_of_the_relative_pose() -> None:
    report = compare(DRIVE, [true_loop("s5", "s0", (0.3, 0.4, 0, 0, 0, np.radians(2.0)))], TARGETS)
    assert report.median_deg == pytest.approx(2.0, abs=1e-6)
    assert report.median_m == pytest.approx(0.5, abs=0.01)
    assert not report.loops[0].false and not report.reached


def test_another_robots_submap_is_a_revisit_without_a_gap() -> None:
    drive = {**DRIVE, "s6": submap(6, 2.0, robot="visitor")}
    assert compare(drive, [], TARGETS).revisits == 3


def test_no_revisits_at_all_is_no_success() -> None:
    assert not compare({"s0": DRIVE["s0"]}, [], TARGETS).reached


def test_odometry_starts_at_the_identity_and_drifts_without_bending_single_steps() -> None:
    true = np.stack([se3.from_yaw(0.0, (float(x), 5.0, 1.0)) for x in range(1001)])
    odometry = drifting(true, seed=3)
    np.testing.assert_allclose(odometry[0], np.eye(4))
    steps = np.linalg.norm(np.diff(odometry[:, :3, 3], axis=0), axis=1)
    np.testing.assert_allclose(steps, 1.0, atol=0.05)
    end = odometry[-1][:3, 3] - [1000.0, 0.0, 0.0]
    assert 0.5 < np.linalg.norm(end) < 60.0


def test_the_demo_drives_about_a_kilometre_and_meets_itself_in_both_directions() -> None:
    patrol, visitor = demo_drives()
    assert 1000.0 < patrol.length_m < 1500.0 and 100.0 < visitor.length_m < 300.0
    pose = patrol.trajectory.T_world_sensor
    apart = np.abs(np.arange(len(pose))[:, None] - np.arange(len(pose))[None]) * 2.0 > 150.0
    near = apart & (np.linalg.norm(pose[:, None, :3, 3] - pose[None, :, :3, 3], axis=2) < 5.0)
    aligned = np.einsum("ik,jk->ij", pose[:, :2, 0], pose[:, :2, 0])[near]
    assert (aligned > 0.95).any() and (aligned < -0.95).any()
    assert patrol.drift_m > 0.3
