"""What loops between the same two drives say of each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from revisit.core.acceptance import LoopClaim, Station
from revisit.core.acceptance.drive_loops import DriveLoops
from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from tests.support.claims import pair
from tests.support.verdicts import verified

CONFIG = VerificationConfig()
STRIDE_M = 5.0


def shifted(x_m: float, yaw_deg: float = 0.0) -> se3.Matrix4:
    return se3.from_yaw(np.radians(yaw_deg), (x_m, 0.0, 0.0))


def drive(count: int, step_m: float = STRIDE_M, number: int = 1) -> list[Station]:
    return [Station(number, row, se3.from_yaw(0.02 * row, (step_m * row, 0.1 * row, 0.0))) for row in range(count)]


def loop(query: Station, match: Station, pose: se3.Matrix4, covariance: np.ndarray = np.zeros((6, 6))) -> LoopClaim:
    """An accepted claim: of two drives, but where a test says that the drives are one."""
    return LoopClaim(
        replace(query, drive=2) if query.drive == 1 else query, match, verified(pose, covariance=covariance)
    )


def true_loop(query: Station, match: Station, off_m: float = 0.0, yaw_deg: float = 0.0) -> LoopClaim:
    """A loop between drives whose odometry frames are one; `off_m` along the match's x axis."""
    T_match_query = se3.inverse(match.T_odom_submap) @ query.T_odom_submap
    return loop(query, match, shifted(off_m, yaw_deg) @ T_match_query)


def along(off_m: list[float], step_m: float = STRIDE_M) -> list[bool]:
    """Loops of neighbouring submaps, each off by so many metres, and which of them are contradicted."""
    drives = drive(len(off_m), step_m)
    loops = [true_loop(one, one, off) for one, off in zip(drives, off_m, strict=True)]
    return list(DriveLoops(loops, STRIDE_M, CONFIG).contradicted())


def test_a_loop_that_more_than_one_in_five_contradict_does_not_stand() -> None:
    assert along([0.0]) == [False]
    assert along([0.5, 0.0, 0.2, 0.1, 32.0], 0.1) == [False, False, False, False, True]
    assert along([0.5, 0.0, 0.2, 32.0], 0.1) == [True, True, True, True]
    assert along([0.0, 32.0], 0.1) == [True, True]


def test_loops_that_are_turned_against_each_other_contradict() -> None:
    here = drive(1)[0]
    for yaw_deg, contradicted in ((9.0, False), (12.0, True)):
        loops = [true_loop(here, here), true_loop(here, here, 0.0, yaw_deg)]
        assert list(DriveLoops(loops, STRIDE_M, CONFIG).contradicted()) == [contradicted] * 2


def test_what_a_poor_odometry_may_have_drifted_contradicts_nothing() -> None:
    assert along([0.0, 1.4], 0.1) == [False, False]
    assert along([0.0, 3.0], 0.1) == [True, True]
    assert along([0.0, 0.0, 0.0, 0.0, 3.0]) == [False] * 4 + [True]
    near = drive(5)
    loops = [true_loop(near[0], near[0]), true_loop(near[4], near[4], 3.0)]
    assert not DriveLoops(loops, STRIDE_M, CONFIG).contradicted().any()


def test_loops_far_along_the_drives_contradict_only_by_more_than_odometry_drifts_there() -> None:
    far = drive(30)
    for last, off_m, contradicted in ((8, 6.0, False), (8, 32.0, True), (25, 18.0, False), (25, 40.0, True)):
        loops = [true_loop(far[0], far[0]), true_loop(far[last], far[last], off_m)]
        between = DriveLoops(loops, STRIDE_M, CONFIG)
        assert list(between.contradicted()) == [contradicted] * 2
        assert between.neighbours(0) == [] and not between.has_accepted_neighbour(0)


def test_loops_too_far_along_the_drives_say_nothing_of_each_other() -> None:
    far = drive(40)
    loops = [true_loop(far[0], far[0]), true_loop(far[38], far[38], 200.0)]
    assert not DriveLoops(loops, STRIDE_M, CONFIG).contradicted().any()


def test_far_loops_that_agree_do_not_save_one_that_its_neighbours_contradict() -> None:
    """Carried over 300 m they cannot tell 10 m."""
    way = drive(70)
    loops = [true_loop(one, one) for one in way[28:33]] + [true_loop(one, one) for one in (*way[:15], *way[50:])]
    found = DriveLoops([*loops, true_loop(way[30], way[30], 10.0)], STRIDE_M, CONFIG).contradicted()
    assert list(found) == [False] * len(loops) + [True]


def within_drive(off_m: float, ordinals_apart: int, yaw_rad: float = 0.0) -> LoopClaim:
    """A loop of one drive that comes back to where it began, says a loop that is `off_m` off by its odometry."""
    first, last = Station(9, 0, np.eye(4)), Station(9, ordinals_apart, se3.from_yaw(yaw_rad, (3.0, 1.0, 0.0)))
    return loop(last, first, shifted(off_m) @ last.T_odom_submap)


def test_a_loop_of_one_drive_is_refuted_by_what_its_odometry_cannot_have_drifted() -> None:
    for off_m, ordinals_apart, refuted in ((25.0, 50, False), (49.0, 50, True), (113.0, 78, True), (5.0, 50, False)):
        (found,) = DriveLoops([within_drive(off_m, ordinals_apart)], STRIDE_M, CONFIG).refuted
        assert found == refuted
    two_drives = within_drive(113.0, 78)
    assert not DriveLoops(
        [replace(two_drives, match=replace(two_drives.match, drive=1))], STRIDE_M, CONFIG
    ).refuted.any()


def test_a_refuted_loop_says_nothing_of_others() -> None:
    false, right = within_drive(113.0, 78), within_drive(0.3, 79)
    between = DriveLoops([false, right], STRIDE_M, CONFIG)
    assert list(between.refuted) == [True, False] and not between.contradicted()[1]
    np.testing.assert_allclose(between.other_poses(0)[0], false.query.T_odom_submap, atol=1e-9)


def test_what_is_said_instead_of_a_contradicted_loop_is_named_once_each() -> None:
    drives = drive(5, 0.1)
    off_m = (0.0, 32.0, 32.4, -32.0, 0.2)
    loops = [true_loop(one, one, off) for one, off in zip(drives, off_m, strict=True)]
    others = DriveLoops(loops, 0.1, CONFIG).other_poses(0)
    np.testing.assert_allclose(sorted(pose[0, 3] for pose in others), [-32.0, 32.0], atol=0.5)


def ramp(turns: int, rise_m: float, turn_m: float = 75.0, drift: float = 0.0, number: int = 1) -> list[Station]:
    """The submaps of a drive up a round ramp; odometry's height drifts by so many metres a metre."""
    count = round(turns * turn_m / STRIDE_M)
    turned, way_m = 2.0 * np.pi * STRIDE_M * np.arange(count) / turn_m, STRIDE_M * np.arange(count)
    height_m, radius_m = (rise_m / turn_m + drift) * way_m, turn_m / (2.0 * np.pi)
    at = np.stack([radius_m * np.cos(turned), radius_m * np.sin(turned), height_m], axis=1)
    return [Station(number, row, se3.from_yaw(turned[row] + np.pi / 2, at[row])) for row in range(count)]


def loops_of_turns(
    queries: list[Station], matches: list[Station], of_one_drive: bool = False, height_m: float = 0.0
) -> list[LoopClaim]:
    """What geometry says where all turns of a ramp look alike: each submap lies where any turn of the other does."""
    pose = se3.from_yaw(0.0, (0.3, 0.0, 0.0))
    near = [(one, other) for one in queries for other in matches if (one.ordinal - other.ordinal) % 15 == 0]
    near = [(one, other) for one, other in near if not of_one_drive or one.ordinal > other.ordinal]
    covariance = np.diag([0.0, 0.0, height_m**2, 0.0, 0.0, 0.0])
    return [loop(one, other, pose, covariance) for one, other in near]


def test_turns_of_a_ramp_contradict_each_other_by_their_height() -> None:
    loops = loops_of_turns(ramp(1, 3.2), ramp(3, 3.2))
    found = DriveLoops(loops, STRIDE_M, CONFIG)
    assert len(loops) == 45 and found.contradicted().all()
    heights = sorted(round(float(pose[2, 3]), 1) for pose in found.other_poses(0))
    assert heights == [3.2, 6.4]


def test_heights_contradict_nothing_that_odometry_shows_to_drift_as_far() -> None:
    """A yard that is round and level, of which the heights drift apart by three metres a round."""
    loops = loops_of_turns(ramp(1, 0.0, drift=-0.02), ramp(3, 0.0, drift=0.02))
    between = DriveLoops(loops, STRIDE_M, CONFIG)
    assert np.ptp([one.match.T_odom_submap[2, 3] for one in loops]) > 4.0
    assert not between.contradicted().any()


def test_a_height_that_is_not_sure_contradicts_none() -> None:
    loops = loops_of_turns(ramp(1, 3.2), ramp(2, 3.2))
    unsure = loops_of_turns(ramp(1, 3.2), ramp(2, 3.2), height_m=0.5)
    assert DriveLoops(loops, STRIDE_M, CONFIG).contradicted().all()
    assert not DriveLoops(unsure, STRIDE_M, CONFIG).contradicted().any()


def on_its_side(claim: LoopClaim) -> LoopClaim:
    """The same loop between drives whose sensor lies on its side, in an odometry that knows that."""
    T_body_sensor = se3.exp([0.0, 0.0, 0.0, np.pi / 2.0, 0.0, 0.0])
    stations = (replace(one, T_odom_submap=one.T_odom_submap @ T_body_sensor) for one in (claim.query, claim.match))
    adjoint = se3.adjoint(se3.inverse(T_body_sensor))
    measured = claim.measurement
    pose = se3.inverse(T_body_sensor) @ measured.T_match_query @ T_body_sensor
    return loop(*stations, pose, adjoint @ measured.covariance @ adjoint.T)


def test_heights_are_those_of_the_odometry_however_the_sensor_is_mounted() -> None:
    loops = loops_of_turns(ramp(1, 3.2), ramp(3, 3.2))
    level, turned = (DriveLoops(some, STRIDE_M, CONFIG) for some in (loops, [on_its_side(one) for one in loops]))
    assert len(turned.other_poses(0)) == len(level.other_poses(0)) == 2
    unsure = [on_its_side(one) for one in loops_of_turns(ramp(1, 3.2), ramp(2, 3.2), height_m=0.5)]
    np.testing.assert_allclose([one.height_m for one in unsure], 0.5)
    assert not DriveLoops(unsure, STRIDE_M, CONFIG).contradicted().any()


def test_too_few_loops_tell_nothing_of_heights() -> None:
    loops = loops_of_turns(ramp(1, 3.2)[:1], ramp(3, 3.2))
    assert len(loops) == 3 and not DriveLoops(loops, STRIDE_M, CONFIG).contradicted().any()


def test_a_loop_of_one_drive_to_another_turn_is_refuted_by_its_height() -> None:
    way = ramp(3, 3.2, number=9)
    loops = loops_of_turns(way, way, of_one_drive=True)
    refuted = DriveLoops(loops, STRIDE_M, CONFIG).refuted
    assert [one.query.ordinal - one.match.ordinal <= 15 for one in loops] == list(refuted)
    level = ramp(3, 0.0, drift=0.005, number=9)
    assert not DriveLoops(loops_of_turns(level, level, of_one_drive=True), STRIDE_M, CONFIG).refuted.any()


def test_where_nothing_is_said_nothing_is_contradicted() -> None:
    assert list(DriveLoops([], STRIDE_M, CONFIG).contradicted()) == []


def test_a_neighbour_says_where_the_pair_lies_by_the_odometry_of_both_drives() -> None:
    queries, matches = drive(3), [Station(5, row, se3.from_yaw(-1.0, (4.0, 2.0 * row, 0.0))) for row in range(4)]
    T_matches_queries = se3.from_yaw(0.7, (30.0, -4.0, 1.0))
    loops = [
        pair(q, m, [se3.inverse(m.T_odom_submap) @ T_matches_queries @ q.T_odom_submap], reason)
        for q, m, reason in ((queries[0], matches[3], None), (queries[2], matches[1], "AMBIGUOUS"))
    ]
    between = DriveLoops(loops, STRIDE_M, CONFIG)
    assert (between.has_accepted_neighbour(0), between.has_accepted_neighbour(1)) == (False, True)
    (told,) = between.neighbours(1)
    np.testing.assert_allclose(told.poses[0], loops[1].hypotheses[0], atol=1e-9)
    assert told.accepted and (told.query_m < 0.0) and (told.match_m > 0.0)
    assert told.query_m == -np.linalg.norm(queries[2].T_odom_submap[:3, 3])
    assert told.way_m == np.float64(-told.query_m) + 2 * STRIDE_M
