"""The simulated fleet: its drift, its wrong loops, and how far a map of it is from the truth."""

from __future__ import annotations

import numpy as np
import pytest

from lab.fleet.drives import drifting, relative_drift
from lab.fleet.scores import FleetOutcome, aligned, ate_m, table
from lab.fleet.wrong_loops import ALIAS_LENGTH, LEAST_DISTANCE_M, PlacedSubmap, agreeing_loops, random_loops
from revisit.core.geometry import se3


def a_way(count: int = 300) -> np.ndarray:
    """Poses (n, 4, 4) along a wide curve, 2 m apart."""
    turn = se3.from_yaw(0.01, (2.0, 0.0, 0.0))
    poses = [np.eye(4)]
    for _ in range(count - 1):
        poses.append(poses[-1] @ turn)
    return np.stack(poses)


def placed() -> list[PlacedSubmap]:
    """Two sessions on the way, submaps 10 m apart."""
    way = a_way()[::5]
    return [
        PlacedSubmap(f"maps/fleet/sessions/{name}/submaps/{n}", name, n, pose)
        for name in ("a", "b")
        for n, pose in enumerate(way)
    ]


@pytest.mark.parametrize("share", [0.01, 0.02])
def test_odometry_drifts_by_the_share_that_was_asked_for_from_a_start_of_its_own(share: float) -> None:
    way = a_way()
    told = drifting(way, share, seed=3)
    assert relative_drift(way, told) == pytest.approx(share, rel=0.02)
    assert np.linalg.norm(told[0, :2, 3]) > 1.0 and relative_drift(way, way) == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_array_equal(told, drifting(way, share, seed=3))


def test_wrong_loops_join_places_that_are_far_apart() -> None:
    truth = {one.name: one.T_world_submap for one in placed()}
    for loop in (*random_loops(placed(), 30, seed=1), *agreeing_loops(placed(), 30, seed=1)):
        apart = np.linalg.norm(truth[loop.query][:3, 3] - truth[loop.match][:3, 3])
        assert apart > LEAST_DISTANCE_M


def test_aliases_agree_with_each_other_and_random_loops_do_not() -> None:
    truth = {one.name: one.T_world_submap for one in placed()}

    def spread(loops):
        """How far loops differ in where they put the one way on the other, metres, at the first one's query."""
        moves = [truth[one.match] @ one.T_match_query @ se3.inverse(truth[one.query]) for one in loops]
        at = truth[loops[0].query]
        return np.ptp(np.stack([(move @ at)[:3, 3] for move in moves]), axis=0).max()

    assert spread(agreeing_loops(placed(), 2 * ALIAS_LENGTH, seed=2)[:ALIAS_LENGTH]) < 1.0
    assert spread(random_loops(placed(), ALIAS_LENGTH, seed=2)) > 10.0


def test_the_error_of_a_trajectory_does_not_see_where_its_frame_lies() -> None:
    truth = {one.name: one.T_world_submap for one in placed()}
    T = se3.from_yaw(2.0, (500.0, -300.0, 20.0))
    moved = {name: T @ pose for name, pose in truth.items()}
    assert ate_m(moved, truth) == pytest.approx(0.0, abs=1e-9)
    lifted = {
        name: pose @ se3.from_yaw(0.0, (0.0, 0.0, 0.3 * (-1) ** n)) for n, (name, pose) in enumerate(moved.items())
    }
    assert ate_m(lifted, truth) == pytest.approx(0.3, abs=0.002)
    back = aligned(moved, truth)
    assert all(np.allclose(back[name], pose, atol=1e-9) for name, pose in truth.items())
    with pytest.raises(ValueError, match="fewer than three"):
        ate_m(dict(list(moved.items())[:2]), truth)


@pytest.mark.parametrize(
    ("changes", "reached"),
    [({}, True), ({"wrong_kept": 1}, False), ({"good_kept": 94}, False), ({"after_m": 0.12}, False),
     ({"after_m": 0.6, "clean_m": 0.6}, False), ({"placed": 49}, False)],
)  # fmt: skip
def test_the_goals_of_a_map_of_the_fleet(changes: dict[str, float], reached: bool) -> None:
    fields = {
        "title": "50 % random", "submaps": 50, "placed": 50, "good": 100, "good_kept": 99, "wrong": 100,
        "wrong_kept": 0, "before_m": 40.0, "after_m": 0.1, "clean_m": 0.1, "seconds": 2.0,
    }  # fmt: skip
    outcome = FleetOutcome(**{**fields, **changes})
    assert outcome.reached is reached
    assert "| 50 % random |" in table([outcome])
