"""What the demo says of its map: errors by hand, the pair that closed the loop, steps that are never silent."""

from __future__ import annotations

import io
import itertools
import threading

import numpy as np
import pytest
from rich.console import Console
from scipy.spatial.transform import Rotation

from lab.fleet.scores import ate_m
from revisit.cli.demo.report import show_map
from revisit.cli.demo.steps import step
from revisit.core.geometry import se3
from revisit.evaluation.demo import FoundLoop, Targets, TrueSubmap, closing_pair, compare, judge_map
from revisit.evaluation.demo.pair import standing
from revisit.evaluation.trajectory_error import trajectory_error

# A square of 30 m, once round and a little further; its odometry turns 1 degree too far at each submap.
CORNERS = 10.0 * np.array([(0, 0), (1, 0), (2, 0), (3, 0), (3, 1), (3, 2), (3, 3), (2, 3), (1, 3), (0, 3), (0, 2),
                           (0, 1), (0, 0), (1, 0)])  # fmt: skip
TRUE = [TrueSubmap(f"p{k}", "patrol", k, np.append(at, 0.0), se3.from_yaw(0.3 * k, np.append(at, 0.0)))
        for k, at in enumerate(CORNERS)]  # fmt: skip
VISIT = [TrueSubmap(f"v{k}", "visitor", 50 + k, TRUE[k].position, TRUE[k].T_world_submap) for k in (3, 2, 1)]
SUBMAPS = {submap.name: submap for submap in [*TRUE, *VISIT]}
T_WORLD_MAP = se3.from_yaw(0.7, (5.0, -3.0, 2.0))


def odometry(submaps, turn_deg):
    """Poses that start at the identity; each step has turned `turn_deg` too far."""
    poses = {submaps[0].name: np.eye(4)}
    for before, after in itertools.pairwise(submaps):
        moved = se3.inverse(before.T_world_submap) @ after.T_world_submap
        poses[after.name] = poses[before.name] @ se3.from_yaw(np.radians(turn_deg)) @ moved
    return poses


@pytest.fixture(scope="module")
def T_odom_submap():
    return odometry(TRUE, 1.0) | odometry(VISIT, 0.0)


@pytest.fixture(scope="module")
def report(T_odom_submap):
    in_map = {name: se3.inverse(T_WORLD_MAP) @ submap.T_world_submap for name, submap in SUBMAPS.items()}
    in_map["p5"] = in_map["p5"] @ se3.from_yaw(0.0, (0.0, 0.0, 0.4))
    return judge_map(SUBMAPS, T_odom_submap, in_map, {"patrol": np.eye(4), "visitor": T_WORLD_MAP}, (7, 1))


def test_the_error_of_a_trajectory_does_not_depend_on_where_its_frame_lies():
    truth = np.stack([submap.position for submap in TRUE])
    assert trajectory_error(se3.apply(T_WORLD_MAP, truth), truth) == pytest.approx(0.0, abs=1e-9)
    raised = truth + np.where(np.arange(len(truth)) % 2 == 0, 0.3, -0.3)[:, None] * [0.0, 0.0, 1.0]
    assert trajectory_error(raised, truth) == pytest.approx(0.3, rel=0.05)


@pytest.mark.parametrize("seed", range(4))
def test_the_error_of_a_trajectory_is_that_of_scipys_best_rotation(seed):
    """Independent of our fit: the fit of evo's `evo_ape tum --align`, by scipy's Rotation.align_vectors."""
    rng = np.random.default_rng(seed)
    truth = np.cumsum(rng.normal(0.0, 1.0, (200, 3)), axis=0) * [1.0, 1.0, 0.05]
    drifted = truth + np.cumsum(rng.normal(0.0, 0.05, (200, 3)), axis=0)
    estimate = se3.apply(T_WORLD_MAP, drifted @ Rotation.from_rotvec(rng.normal(0.0, 1.0, 3)).as_matrix())
    centred, expected = estimate - estimate.mean(axis=0), truth - truth.mean(axis=0)
    rotation, distance = Rotation.align_vectors(expected, centred)
    np.testing.assert_allclose(trajectory_error(estimate, truth), distance / np.sqrt(len(truth)), rtol=1e-9)
    gaps = np.linalg.norm(rotation.apply(centred) - expected, axis=1)
    poses = [{str(n): se3.from_yaw(0.1 * n, at) for n, at in enumerate(all_of)} for all_of in (estimate, truth)]
    assert ate_m(*poses) == pytest.approx(np.sqrt(np.mean(gaps**2)), rel=1e-9)


def test_odometry_starts_at_the_truth_and_the_map_is_laid_on_it_as_a_whole(report):
    patrol, visitor = report.tracks
    assert (patrol.robot, visitor.robot) == ("patrol", "visitor")
    assert patrol.odometry_off_m[0] == pytest.approx(0.0, abs=1e-9) and patrol.odometry_off_m[-1] > 2.0
    assert visitor.odometry_off_m.max() == pytest.approx(0.0, abs=1e-9)
    # One submap of seventeen was raised by 0.4 m: the fit spreads a little of that over the others.
    assert patrol.map_off_m.argmax() == 5 and 0.25 < patrol.map_off_m[5] < 0.4
    assert report.ate_m == pytest.approx(0.4 / np.sqrt(17), rel=0.2)
    assert patrol.odometry_ate_m > report.ate_m and report.better


def test_the_table_of_the_map_tells_both_errors_and_the_correction(report):
    printed = io.StringIO()
    show_map(report, Console(file=printed, width=140))
    assert "7 loop closures hold it, 1 are set aside" in printed.getvalue()
    assert "5.0 m, -3.0 m, 40.1 deg" in printed.getvalue() and "reached" in printed.getvalue()


def test_the_pair_that_is_shown_is_the_true_loop_that_odometry_had_wrong_most(T_odom_submap):
    def loop(query, match, off=0.0):
        T = se3.inverse(SUBMAPS[match].T_world_submap) @ SUBMAPS[query].T_world_submap
        return FoundLoop(query, match, T @ se3.from_yaw(0.0, (off, 0.0, 0.0)))

    loops = [loop("p12", "p0"), loop("p4", "p3"), loop("p13", "p0", off=9.0), loop("v1", "p1")]
    judged = compare(SUBMAPS, loops, Targets()).loops
    pair = closing_pair(judged, SUBMAPS, T_odom_submap)
    assert (pair.loop.query, pair.loop.match) == ("p12", "p0")
    apart = (T_odom_submap["p12"] - SUBMAPS["p12"].T_world_submap)[:3, 3]
    assert pair.gap_m == pytest.approx(np.linalg.norm(apart), rel=1e-6)
    assert closing_pair([], SUBMAPS, T_odom_submap) is None


def test_what_stands_is_told_from_the_ground_of_its_cell():
    ground = np.array([(x, y, 0.05 * x) for x in range(20) for y in range(20)], dtype=np.float32)
    wall = np.array([(5.0, 5.0, z) for z in (1.5, 2.0, 3.0)], dtype=np.float32)
    np.testing.assert_array_equal(standing(np.vstack([ground, wall])), wall)


class Lines(io.StringIO):
    """A file that is no terminal and tells when it has been written to so many times."""

    def __init__(self, wanted: int) -> None:
        super().__init__()
        self.there, self._wanted = threading.Event(), wanted

    def write(self, text: str) -> int:
        written = super().write(text)
        if self.getvalue().count("\n") >= self._wanted:
            self.there.set()
        return written


def test_outside_a_terminal_a_step_that_lasts_says_how_it_stands_again_and_again():
    said = Lines(wanted=3)
    with step(Console(file=said, width=100), "submaps are described", 132, every_s=0.001) as shown:
        shown.done = 7
        assert said.there.wait(60.0)
    lines = said.getvalue().splitlines()
    assert all(line.startswith("  submaps are described: ") for line in lines[:-1])
    assert lines[-1].startswith("submaps are described: 7 of 132")


def test_a_step_that_fails_ends_and_lets_the_failure_through():
    with pytest.raises(RuntimeError, match="no disk"), step(Console(file=io.StringIO()), "work"):
        raise RuntimeError("no disk")
    assert not [thread for thread in threading.enumerate() if thread.name == "demo-step"]
