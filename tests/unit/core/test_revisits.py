"""Which submaps of a drive may be loops with one: a place just left is none, one left and entered again is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from revisit.core.acceptance.revisits import are_revisits, candidate_policy
from revisit.core.config import LoopConfig, PipelineConfig
from revisit.evaluation.ground_truth import GroundTruth

Positions = NDArray[np.float64]
CONFIG = LoopConfig(leave_distance=5.0, drift=0.02)


def along(*corners: tuple[float, float], step_m: float = 5.0) -> Positions:
    """Positions every `step_m` of a way through corners."""
    ends = np.array(corners)
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ends, axis=0), axis=1))])
    way = np.arange(0.0, at[-1] + 1e-9, step_m)
    return np.column_stack([np.interp(way, at, ends[:, 0]), np.interp(way, at, ends[:, 1]), np.zeros(len(way))])


def revisits(positions: Positions, row: int, config: LoopConfig = CONFIG) -> list[int]:
    return np.flatnonzero(are_revisits(positions, row, config)).tolist()


def test_a_hall_of_twenty_metres_driven_there_and_back_is_revisited() -> None:
    hall = along((0, 0), (20, 0), (0, 0))
    # Rows 0 to 4 lead there, 5 to 8 back: at 15, 10, 5 and 0 m.
    assert [revisits(hall, row) for row in range(5, 9)] == [[], [1, 2], [0, 1, 2], [0, 1]]


def test_a_street_straight_ahead_is_no_revisit_before_odometry_cannot_tell() -> None:
    street = along((0, 0), (400, 0))
    assert revisits(street, 49) == []
    assert revisits(street, 52) == [0, 1, 2]  # 250 m and more


def test_standing_and_turning_on_the_spot_is_no_revisit_however_long_it_takes() -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.05, (2000, 3))
    assert revisits(noise, 1999) == []


def test_a_round_that_never_leaves_the_place_is_no_revisit_before_odometry_cannot_tell() -> None:
    turn = np.linspace(0.0, 4.0 * np.pi, 21)
    assert revisits(2.4 * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(21)]), 20) == []


def test_the_distance_grows_with_the_drift_of_the_way() -> None:
    beside = along((0, 0), (50, 0), (50, 16.5), (0, 16.5), step_m=0.5)
    assert 0 in revisits(beside, len(beside) - 1)  # after 116.5 m, an aisle is 17.3 m away at most
    assert 0 not in revisits(beside, len(beside) - 1, replace(CONFIG, drift=1e-6))


@pytest.mark.parametrize("aside_m", [6.0, 8.0, 12.0])
def test_a_drive_there_and_back_is_revisited_in_the_lane_beside(aside_m: float) -> None:
    lanes = along((0, 0), (40, 0), (40, aside_m), (0, aside_m), step_m=1.0)
    last = len(lanes) - 1  # at the begin of the way, aside
    assert 0 in revisits(lanes, last)
    assert all(np.linalg.norm(lanes[one] - lanes[last]) <= 17.0 for one in revisits(lanes, last))


def test_a_lane_beside_beyond_the_radius_of_an_evaluation_is_no_wrong_match() -> None:
    lanes = along((0, 0), (40, 0), (40, 8), (0, 8), step_m=1.0)
    within, beyond = (GroundTruth.of_one_drive(lanes, CONFIG, radius_m) for radius_m in (9.0, 7.0))
    assert within.positives[-1, 0]
    assert not beyond.allowed[-1, 0]


def test_a_bend_of_the_way_is_no_revisit() -> None:
    """Though the drive comes nearer again, by less than it must leave a place."""
    bend = along((0, 0), (12, 0), (12, 12), (24, 12), step_m=2.0)
    assert all(revisits(bend, row) == [] for row in range(len(bend)))


def test_two_submaps_are_revisits_of_each_other_or_neither_is() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        walk = np.cumsum(rng.normal(0.0, 4.0, (40, 3)) * [1, 1, 0.1], axis=0)
        table = np.array([are_revisits(walk, row, CONFIG) for row in range(len(walk))])
        np.testing.assert_array_equal(table, table.T)


def test_what_lies_beyond_a_revisit_by_way_changes_nothing() -> None:
    """So that a part of a long drive is enough."""
    rng = np.random.default_rng(4)
    walk = np.cumsum(rng.normal(0.0, 4.0, (300, 3)) * [1, 1, 0], axis=0)
    part = slice(100, 250)
    np.testing.assert_array_equal(are_revisits(walk, 200, CONFIG)[part], are_revisits(walk[part], 100, CONFIG))


def test_every_submap_may_be_a_loop_where_nothing_need_be_left() -> None:
    assert revisits(np.zeros((4, 3)), 1, replace(CONFIG, leave_distance=0.0)) == [0, 2, 3]


def test_two_submaps_with_a_scan_in_common_are_never_revisits() -> None:
    """Left by half a submap, they are a submap apart along the way."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        scans = np.cumsum(rng.normal(0.0, 1.0, (400, 3)) * [1, 1, 0], axis=0)
        way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(scans, axis=0), axis=1))])
        windows = [(way >= start) & (way <= start + 10.0) for start in np.arange(0.0, way[-1] - 10.0, 5.0)]
        positions = np.array([scans[window].mean(axis=0) for window in windows])
        for row, window in enumerate(windows):
            assert not any((window & windows[other]).any() for other in revisits(positions, row))


@pytest.mark.parametrize(("tau", "asked", "in_force"), [(None, None, 5.0), (4.0, None, 2.0), (4.0, 7.0, 7.0)])
def test_the_distance_is_half_a_submap_unless_the_map_has_its_own(
    tau: float | None, asked: float | None, in_force: float
) -> None:
    config = PipelineConfig().of_map(0.25, {"tau": tau}, {"leave_distance": asked}, {})
    assert config.loop.leave_distance == in_force


def test_a_policy_names_the_submaps_just_left_and_the_one_itself() -> None:
    hall = along((0, 0), (20, 0), (0, 0))
    policy = candidate_policy(3, np.arange(100, 109), hall, 8, CONFIG)
    assert (policy.session, policy.too_near) == (3, frozenset(range(102, 109)))
