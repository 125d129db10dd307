"""Which hypothesis of an ambiguous loop the loops beside it single out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from revisit.core.acceptance.neighbour_support import NeighbourLoop, find_support
from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3

CONFIG = VerificationConfig()


def shifted(x_m: float, yaw_deg: float = 0.0) -> se3.Matrix4:
    return se3.from_yaw(np.radians(yaw_deg), (x_m, 0.0, 0.0))


ROW = (shifted(10.0), shifted(0.0), shifted(-10.0))
"""Three hypotheses, a house apart."""


def beside(ahead_m: float, accepted: bool = True, poses=(shifted(0.2),)) -> NeighbourLoop:
    return NeighbourLoop(accepted, poses, ahead_m, ahead_m, 2 * abs(ahead_m))


def test_accepted_loops_of_two_submaps_over_enough_way_single_out_the_hypothesis_they_agree_with() -> None:
    support = find_support(ROW, [beside(10.0), beside(16.0)], CONFIG)
    assert support is not None
    assert (support.hypothesis, support.anchors, support.agreeing, support.along_m) == (1, 2, 2, 16.0)


@pytest.mark.parametrize(
    "neighbours",
    [
        [],
        [beside(ahead, accepted=False, poses=ROW) for ahead in (-20.0, -10.0, 10.0, 20.0)],
        [beside(16.0)],
        [beside(16.0), beside(16.0)],
        [beside(4.0), beside(8.0)],
        [beside(10.0), beside(16.0), beside(20.0, poses=(shifted(10.0),))],
        [beside(10.0, poses=(shifted(0.0, 8.0),)), beside(16.0, poses=(shifted(0.0, 8.0),))],
        [beside(40.0), beside(50.0)],
    ],
    ids=[
        "nothing", "an endless row", "one submap", "two loops of one submap", "too short a way", "one contradicts",
        "turned", "too far for odometry",
    ],
)  # fmt: skip
def test_less_than_that_singles_out_nothing(neighbours: list[NeighbourLoop]) -> None:
    assert find_support(ROW, neighbours, CONFIG) is None


def test_where_most_ambiguous_loops_beside_it_do_not_have_the_hypothesis_it_has_no_support() -> None:
    anchors, others = [beside(10.0), beside(16.0)], [beside(a, False, (shifted(10.0),)) for a in (4.0, 6.0, 8.0)]
    assert find_support(ROW, [*anchors, *others[:2]], CONFIG) is not None
    assert find_support(ROW, [*anchors, *others], CONFIG) is None


def test_hypotheses_nearer_to_each_other_than_odometry_is_sure_are_not_told_apart() -> None:
    close = (shifted(0.0), shifted(1.7))
    neighbours = [beside(20.0), beside(29.0)]
    assert find_support(close, neighbours, CONFIG) is None
    assert find_support(close, neighbours, replace(CONFIG, support_drift=0.0)) is not None


def test_a_hypothesis_with_a_twin_nearby_needs_shorter_ways_than_one_without() -> None:
    twins = (shifted(0.0), shifted(1.2), shifted(-10.0))
    away = [beside(ahead, poses=(shifted(-10.1),)) for ahead in (16.0, 24.0)]
    support = find_support(twins, away, CONFIG)
    assert support is not None and support.hypothesis == 2
    at_twin = [beside(ahead, poses=(shifted(0.1),)) for ahead in (16.0, 24.0)]
    assert find_support(twins, at_twin, CONFIG) is None
    assert find_support((shifted(0.0), shifted(-10.0)), at_twin, CONFIG) is not None


def test_an_accepted_loop_that_cannot_tell_twins_apart_may_not_contradict_either() -> None:
    twins, anchors = (shifted(0.0), shifted(1.9)), [beside(10.0), beside(16.0)]
    far = beside(28.0, poses=(shifted(-4.0),))
    assert find_support(twins, anchors, CONFIG) is not None
    assert find_support(twins, [*anchors, far], CONFIG) is None
