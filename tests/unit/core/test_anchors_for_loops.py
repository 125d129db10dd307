"""Anchors choose among the poses of a pair where places repeat; receivers that err choose none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.core.pose_graph.anchored_drive import AnchoredDrive
from revisit.core.pose_graph.anchors import Anchor
from revisit.core.pose_graph.anchors_for_loops import AnchorsForLoops, OpenPair
from revisit.core.pose_graph.graph import Node

STEP_M, SUBMAPS, PERIOD_M = 5.0, 30, 6.0
T_A_B = se3.from_yaw(0.4, (3.0, 1.0, 0.0))
"""The odometry frame of drive b lies so in that of drive a, which is the world's, turned by half a radian."""
T_WORLD_A = se3.from_yaw(0.5, (100.0, 50.0, 0.0))


def drive(T_a_odom=None):
    """A drive 1 m beside the x axis of drive a, in its own odometry frame (n, 4, 4)."""
    aside = 0.0 if T_a_odom is None else 1.0
    T_a_submap = [se3.from_yaw(0.0, (STEP_M * n, aside, 0.0)) for n in range(SUBMAPS)]
    return np.stack(T_a_submap if T_a_odom is None else [se3.inverse(T_a_odom) @ T for T in T_a_submap])


DRIVES = {"a": drive(), "b": drive(T_A_B)}


def fixes(session, sigma_m, shift=(0.0, 0.0, 0.0), ordinals=range(SUBMAPS), seed=3, sigma_up_m=0.1):
    random = np.random.default_rng(seed)
    T_world_odom = T_WORLD_A if session == "a" else T_WORLD_A @ T_A_B
    found = []
    for n in ordinals:
        place = (
            (T_world_odom @ DRIVES[session][n])[:3, 3] + np.array(shift) + np.append(random.normal(0, sigma_m, 2), 7)
        )
        covariance = np.diag([sigma_m**2, sigma_m**2, sigma_up_m**2])
        found.append(Anchor(f"{session}:{n}", Node(session, n), np.zeros(3), place, covariance))
    return found


def pairs(shifts=(0, 1, -1), period_m=PERIOD_M, ordinals=range(0, SUBMAPS, 3), ahead=0):
    """Pairs of which the first pose is true, unless `shifts` says otherwise; the others are off by periods."""
    found = []
    for n in ordinals:
        T_a_query = T_A_B @ DRIVES["b"][n]
        match = min(n + ahead, SUBMAPS - 1)
        true = se3.inverse(DRIVES["a"][match]) @ T_a_query
        poses = tuple(se3.from_yaw(0.0, (period_m * k, 0.0, 0.0)) @ true for k in shifts)
        found.append(OpenPair(f"{n}", Node("a", match), Node("b", n), poses))
    return found


def chosen(anchors, some=None):
    return AnchorsForLoops(DRIVES, anchors).chosen(pairs() if some is None else some)


@pytest.mark.parametrize("shifts", [(0, 1, -1), (2, 1, 0), (-1, 0, 1)])
def test_fixes_of_centimetres_choose_the_true_pose_of_a_lattice_of_six_metres(shifts):
    found = chosen([*fixes("a", 0.03), *fixes("b", 0.03)], pairs(shifts))
    assert found == {f"{n}": shifts.index(0) for n in range(0, SUBMAPS, 3)}


def test_fixes_of_two_metres_choose_none_there_but_among_houses_forty_metres_apart():
    anchors = [*fixes("a", 2.0), *fixes("b", 2.0, seed=4)]
    assert chosen(anchors) == {}
    found = chosen(anchors, pairs(period_m=40.0))
    assert len(found) >= 8 and set(found.values()) == {0}


def test_a_true_pose_that_no_hypothesis_has_lets_none_be_chosen():
    assert chosen([*fixes("a", 0.03), *fixes("b", 0.03)], pairs((1, 2, -1))) == {}


@pytest.mark.parametrize(
    "shift", [(3.0, 0.0, 0.0), (0.0, 2.5, 0.0), (0.0, 0.0, 3.2)], ids=["on", "aside", "a storey up"]
)
def test_a_base_station_in_the_wrong_place_chooses_none(shift):
    assert chosen([*fixes("a", 0.03), *fixes("b", 0.03, shift)]) == {}


def test_nothing_is_chosen_where_heights_do_not_tell_storeys_apart():
    assert chosen([*fixes("a", 0.03, sigma_up_m=1.0), *fixes("b", 0.03, sigma_up_m=1.0)]) == {}


def test_a_third_of_the_pairs_with_a_pose_that_fits_is_enough_and_a_fifth_is_too_few():
    anchors = [*fixes("a", 0.03), *fixes("b", 0.03)]

    def some(share):
        return [
            one if n < share * 30 else replace(one, poses=one.poses[1:])
            for n, one in enumerate(pairs(ordinals=range(30)))
        ]

    assert len(chosen(anchors, some(0.4))) == 12
    assert chosen(anchors, some(0.2)) == {}


def test_accepted_loops_that_anchors_contradict_let_them_choose_nothing():
    right = pairs()
    accepted = [replace(one, name=f"a{one.name}", poses=one.poses[:1], accepted=True) for one in right]
    wrong = [replace(one, poses=(se3.from_yaw(0.0, (2.0, 0.0, 0.0)) @ one.poses[0],)) for one in accepted]
    anchors = [*fixes("a", 0.03), *fixes("b", 0.03)]
    assert len(chosen(anchors, [*right, *accepted])) == len(right)
    assert chosen(anchors, [*right, *accepted[:6], *wrong[6:]]) == {}


def test_one_pose_alone_is_chosen_by_fixes_of_centimetres_only():
    some = pairs((0,))
    assert len(chosen([*fixes("a", 0.03), *fixes("b", 0.03)], some)) == len(some)
    assert chosen([*fixes("a", 1.0), *fixes("b", 1.0)], some) == {}


def test_pairs_far_apart_on_earth_are_no_evidence_and_are_not_chosen():
    """Twins 50 m along the drive fit as well; the right pairs are chosen all the same."""
    right = pairs(ordinals=range(0, 18, 3))
    twins = [OpenPair(f"twin{one.name}", Node("a", one.match.ordinal + 10), one.query, one.poses) for one in right]
    found = chosen([*fixes("a", 0.03), *fixes("b", 0.03)], [*right, *twins])
    assert found == {one.name: 0 for one in right}


@pytest.mark.parametrize("ordinals", [[], [3], [3, 4], range(9, 11)])
def test_too_few_anchors_choose_none(ordinals):
    assert chosen([*fixes("a", 0.03), *fixes("b", 0.03, ordinals=ordinals)]) == {}


def test_two_submaps_are_too_few():
    assert chosen([*fixes("a", 0.03), *fixes("b", 0.03)], pairs(ordinals=(3, 9))) == {}


def test_reflections_of_a_fifth_of_the_fixes_choose_nothing_wrong():
    wrong = [
        Anchor(one.name, one.node, one.point_submap, one.place_world + (PERIOD_M, 0.0, 0.0), one.covariance)
        if one.node.ordinal % 5 == 0
        else one
        for one in fixes("b", 0.03)
    ]
    assert set(chosen([*fixes("a", 0.03), *wrong]).values()) <= {0}


def on(anchors, off):
    """Anchors whose places are wrong by off(ordinal), metres along drive a."""
    ahead = T_WORLD_A[:3, 0]
    return [replace(one, place_world=one.place_world + off(one.node.ordinal) * ahead) for one in anchors]


A, B = fixes("a", 0.03), fixes("b", 0.03)


def test_a_loop_that_anchors_chose_stays_where_they_put_it_and_only_there():
    some = [replace(one, chosen=True) for one in pairs()]
    assert chosen([*A, *B], some) == {one.name: 0 for one in some}
    moved = replace(some[0], poses=(se3.from_yaw(0.0, (1.5, 0.0, 0.0)) @ some[0].poses[0], *some[0].poses[1:]))
    assert some[0].name not in chosen([*A, *B], [moved, *some[1:]])
    assert chosen(A, some) == {}


def test_loops_that_anchors_chose_are_no_evidence_for_anchors():
    """A base station a period off has chosen many; few loops that geometry is sure of contradict it."""
    some = [replace(one, chosen=True, poses=(one.poses[1], one.poses[0])) for one in pairs(ordinals=range(30))]
    sure = [replace(one, name=f"sure{one.name}", poses=one.poses[:1], accepted=True) for one in pairs((0,))[:5]]
    wrong = on(B, lambda _: PERIOD_M)
    assert len(chosen([*A, *wrong], some)) == 30 and chosen([*A, *wrong], [*some, *sure]) == {}


@pytest.mark.parametrize("off_m", [1.0, 1.5, 2.0, 2.5])
def test_a_base_station_that_is_off_by_nearly_a_period_chooses_none(off_m):
    assert chosen([*A, *on(B, lambda _: off_m)], pairs(period_m=3.0)) == {}


@pytest.mark.parametrize("period_m", [3.0, 6.0])
def test_a_receiver_that_is_wrong_by_a_period_for_a_minute_chooses_nothing_wrong(period_m):
    off = on(B, lambda n: period_m * (10 <= n < 24))
    assert set(chosen([*A, *off], pairs(period_m=period_m, ordinals=range(30))).values()) <= {0}


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("walk_m", [0.5, 3.0])
def test_a_receiver_whose_errors_wander_and_are_not_stated_chooses_nothing_wrong(walk_m, seed):
    off = np.cumsum(np.random.default_rng(seed).normal(0.0, walk_m / np.sqrt(SUBMAPS), SUBMAPS))
    some = pairs((0, 1, -1, 2, -2), period_m=3.0, ordinals=range(30))
    assert set(chosen([*A, *on(B, lambda n: off[n])], some).values()) <= {0}


def test_three_control_points_of_which_one_was_misread_are_not_sure():
    points = [replace(one, place_world=one.place_world + (0.0, 6.0 * (one.node.ordinal == 13), 0.0)) for one in B]
    drive_b = AnchoredDrive.of(DRIVES["b"], [points[n] for n in (5, 9, 13)])
    assert drive_b.fix(9).sigma_m > 0.5
    right = AnchoredDrive.of(DRIVES["b"], [B[n] for n in (5, 9, 13)])
    assert right.fix(9).sigma_m < 0.1


@pytest.mark.parametrize(
    "tilt", [(0.0, -0.5, 0.0), (np.pi / 2, 0.0, 0.0)], ids=["a slanting sensor", "one on its side"]
)
def test_a_sensor_that_does_not_stand_upright_chooses_as_well(tilt, monkeypatch):
    T_submap_sensor = se3.exp(np.array([0.0, 0.0, 0.0, *tilt]))
    upright, back = pairs((0, 1, -1)), se3.inverse(T_submap_sensor)
    some = [replace(one, poses=tuple(back @ T @ T_submap_sensor for T in one.poses)) for one in upright]
    monkeypatch.setattr(
        "tests.unit.core.test_anchors_for_loops.DRIVES", {name: T @ T_submap_sensor for name, T in DRIVES.items()}
    )
    assert chosen([*A, *B], some) == {one.name: 0 for one in some}
