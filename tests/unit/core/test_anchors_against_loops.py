"""Anchors refute loops between twins; receivers that err refute none."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.core.pose_graph.anchors import Anchor
from revisit.core.pose_graph.anchors_against_loops import refuted_by_anchors
from revisit.core.pose_graph.graph import LoopEdge, Node

STEP_M, SUBMAPS = 5.0, 40
RANDOM = np.random.default_rng(7)


def drive(turn: float = 0.0) -> np.ndarray:
    """A straight drive in an odometry frame of its own."""
    return np.stack(
        [se3.from_yaw(turn, tuple(se3.from_yaw(turn)[:3, :3] @ (STEP_M * n, 0.0, 0.0))) for n in range(SUBMAPS)]
    )


def fixes(session, at, sigma=1.5, ordinals=range(SUBMAPS), noise=1.5):
    """Fixes of a straight drive to the east; `at` (2,) or by ordinal is where its frame lies."""
    found = []
    for n in ordinals:
        shift = np.asarray(at(n) if callable(at) else at, dtype=float)
        place = np.append(shift + (STEP_M * n, 0.0) + RANDOM.normal(0.0, noise, 2), 3.0)
        found.append(Anchor(f"{session}:{n}", Node(session, n), np.zeros(3), place, np.diag([sigma**2, sigma**2, 9.0])))
    return found


def loops(ordinals=range(0, SUBMAPS, 2), shift=0, name=""):
    """Loops that put submap n of `b` on submap n + shift of `a`, half a metre beside it, turned by 0.3 rad."""
    T = se3.from_yaw(0.3, (0.4, 0.3, 0.0))
    return [LoopEdge(f"{name}{n}", Node("a", n + shift), Node("b", n), T, np.eye(6)) for n in ordinals]


DRIVES = {"a": drive(), "b": drive(1.0)}
SAME, TWIN = (0.0, 0.6), (0.0, 260.0)


def refuted(a, b, some=None):
    return refuted_by_anchors(DRIVES, loops() if some is None else some, [*a, *b])


def test_a_twin_far_away_is_refuted_by_fixes_of_two_metres():
    some = loops()
    assert refuted(fixes("a", SAME), fixes("b", TWIN), some) == {one.name for one in some}


def test_loops_of_the_same_place_stay():
    assert refuted(fixes("a", SAME), fixes("b", SAME)) == set()


@pytest.mark.parametrize("wrong_m", [6.0, 60.0, 90.0])
def test_a_base_station_in_the_wrong_place_refutes_nothing(wrong_m):
    assert refuted(fixes("a", SAME), fixes("b", (0.0, wrong_m))) == set()


@pytest.mark.parametrize("apart_m", [70.0, 120.0, 140.0])
def test_a_twin_nearby_is_refuted_where_the_receivers_agree_elsewhere(apart_m):
    """Submaps of `b` look as those of `a` do `apart_m` further along, too."""
    ahead = round(apart_m / STEP_M)
    false = loops(range(5, SUBMAPS - ahead), ahead, "false")
    assert refuted(fixes("a", SAME), fixes("b", SAME), false if apart_m > 130 else [*loops(range(12)), *false]) == {
        one.name for one in false
    }


def test_reflections_of_a_street_refute_nothing():
    def reflected(n):
        return (0.0, 44.0 if 10 <= n < 22 else 0.0)

    assert refuted(fixes("a", SAME), fixes("b", reflected)) == set()


def test_jumps_of_a_fifth_of_the_fixes_refute_nothing_and_hide_no_twin():
    def jumps(base):
        return lambda n: np.add(base, (130.0, 30.0) if n % 5 == 0 else (0.0, 0.0))

    assert refuted(fixes("a", SAME), fixes("b", jumps(SAME))) == set()
    assert len(refuted(fixes("a", SAME), fixes("b", jumps(TWIN)))) >= 18


@pytest.mark.parametrize("ordinals", [[], [3], [3, 30]])
def test_too_few_anchors_say_nothing(ordinals):
    assert refuted(fixes("a", SAME), fixes("b", TWIN, ordinals=ordinals)) == set()


def test_fixes_that_state_a_large_error_say_nothing():
    assert refuted(fixes("a", SAME), fixes("b", TWIN, sigma=50.0)) == set()


def test_a_receiver_without_a_fix_says_nothing():
    assert refuted(fixes("a", SAME), fixes("b", lambda n: (5e6, 3e6) if n < 25 else SAME)) == set()


def bent_drive(submaps=160) -> np.ndarray:
    """A drive around blocks of 250 m."""
    poses = [np.eye(4)]
    for n in range(submaps - 1):
        turn = np.radians(18.0) * (1 if n // 100 % 2 == 0 else -1) if n % 50 >= 45 else 0.0
        poses.append(poses[-1] @ se3.from_yaw(turn, (STEP_M, 0.0, 0.0)))
    return np.stack(poses)


def fixes_on(poses, session, ahead=0, shift=(0.0, 0.0), each=1, sigma=0.01, noise=1.5, at=lambda n: (0.0, 0.0)):
    """Fixes of a drive, `each` a submap, told `ahead` submaps before it is there; `at`, errors of the fix by number."""
    found = []
    for number in range((len(poses) - ahead) * each):
        n, on = divmod(number, each)
        point = np.array([STEP_M * on / each, 0.0, 0.0])
        error = RANDOM.normal(0.0, noise, 2) + shift + at(number)
        place = se3.apply(poses[n + ahead], point[None])[0] + [*error, 0.0]
        covariance = np.diag([sigma**2, sigma**2, 9.0])
        found.append(Anchor(f"{session}:{number}", Node(session, n), point, place, covariance))
    return found


def refuted_on(poses, a, b):
    T = se3.from_yaw(0.0, (0.4, 0.3, 0.0))
    some = [LoopEdge(f"{n}", Node("a", n), Node("b", n), T, np.eye(6)) for n in range(0, len(poses), 2)]
    return refuted_by_anchors({"a": poses, "b": poses}, some, [*a, *b])


@pytest.mark.parametrize("seconds", [10, 18])
def test_a_clock_that_is_wrong_refutes_nothing_and_hides_no_twin_of_others(seconds):
    """A car at 20 m/s, a fix each second; clocks of satellites are 18 s ahead."""
    poses = bent_drive()
    late = fixes_on(poses, "b", ahead=seconds * 4)[::4]
    assert refuted_on(poses, fixes_on(poses, "a")[::4], late) == set()
    twin = fixes_on(poses, "b", shift=(0.0, 260.0))[::4]
    assert len(refuted_on(poses, fixes_on(poses, "a")[::4], twin)) >= 78


def test_reflections_for_half_a_minute_refute_nothing_of_a_slow_robot():
    """A robot at 1.5 m/s, a fix each second, two times 30 s of which are 44 m aside."""
    poses = bent_drive(80)

    def reflected(number):
        return (0.0, 44.0) if 60 <= number < 90 or 160 <= number < 190 else (0.0, 0.0)

    a, b = (fixes_on(poses, one, each=3, at=errors) for one, errors in (("a", lambda n: (0.0, 0.0)), ("b", reflected)))
    assert refuted_on(poses, a, b) == set()


def test_reflections_for_half_a_minute_refute_nothing_of_a_car():
    """At 20 m/s, a fix each second that states 1 cm; 600 m of the way are 44 m aside in one of two drives."""
    poses = bent_drive(300)
    b = fixes_on(poses, "b", at=lambda n: (0.0, 44.0) if 100 <= n < 220 else (0.0, 0.0))
    assert refuted_on(poses, fixes_on(poses, "a")[::4], b[::4]) == set()


def test_a_twin_nearby_is_refuted_where_one_drive_passes_both():
    poses = drive()
    false = [
        LoopEdge(f"{n}", Node("a", n), Node("a", n + 14), se3.from_yaw(0.0, (0.4, 0.3, 0.0)), np.eye(6))
        for n in range(26)
    ]
    assert len(refuted_by_anchors({"a": poses}, false, fixes("a", SAME))) >= 24
