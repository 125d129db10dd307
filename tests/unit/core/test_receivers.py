"""Anchors of one session are wrong together: less sure than they state, or elsewhere as a whole. Simulated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from revisit.core.pose_graph.anchors import Anchor, AnchorState
from revisit.core.pose_graph.optimisation import OptimisedGraph, optimise
from tests.support.made_up_anchors import error_m, fixes
from tests.support.made_up_fleet import Fleet, fleet


def three_drives(stated_m: float, true_m: float, shift_m: tuple[float, float, float]) -> tuple[Fleet, list[Anchor]]:
    """Two drives with a receiver of 1.5 m, and a third one that states so much, errs by so much, and is shifted."""
    made = fleet(5, 0.0, sessions=3, submaps=40, per_pair=15)
    good = fixes(made, 1, 1.5, sessions=("s1", "s2"))
    other = [
        replace(one, place_world=one.place_world + shift_m, covariance=stated_m**2 * np.diag([1.0, 1.0, 2.25]))
        for one in fixes(made, 2, true_m, sessions=("s0",))
    ]
    return made, [*other, *good]


def held(anchors: list[Anchor], answer: OptimisedGraph, session: str) -> float:
    """The share of a session's anchors that hold the map."""
    states = [judged.state for one, judged in zip(anchors, answer.anchors, strict=True) if one.node.session == session]
    return states.count(AnchorState.IN_MAP) / len(states)


def test_a_receiver_that_states_a_centimetre_and_errs_by_metres_counts_as_it_errs() -> None:
    made, anchors = three_drives(0.01, 3.0, (0.0, 0.0, 0.0))
    answer = optimise(made.graph, anchors=anchors)
    (told,) = answer.georeferences[0].sessions
    assert told.session == "s0" and 100.0 < told.sigma_factor < 400.0 and not told.elsewhere
    assert error_m(made, answer) < 0.7 and min(held(anchors, answer, one) for one in made.truth) > 0.9


def test_a_receiver_that_tells_a_fix_in_twenty_metres_counts_as_it_errs() -> None:
    made = fleet(5, 0.0, sessions=3, submaps=60, per_pair=25)
    anchors = [one for one in fixes(made, 1, 1.5) if one.node.ordinal % 4 == 0]
    sure = [replace(one, covariance=1e-4 * np.eye(3)) if one.node.session == "s0" else one for one in anchors]
    (told,) = optimise(made.graph, anchors=sure).georeferences[0].sessions
    assert told.session == "s0" and 50.0 < told.sigma_factor < 300.0 and not told.elsewhere


def test_a_fleet_whose_receivers_all_state_too_little_lies_on_earth() -> None:
    made = fleet(5, 0.0, sessions=2, submaps=40, per_pair=15)
    anchors = [replace(one, covariance=one.covariance / 100.0) for one in fixes(made, 3, 3.0)]
    answer = optimise(made.graph, anchors=anchors)
    assert {one.sigma_factor > 5.0 for one in answer.georeferences[0].sessions} == {True}
    assert error_m(made, answer) < 2.0


def test_a_base_station_at_a_wrong_place_does_not_take_along_the_map_of_others() -> None:
    for shift_m in ((6.0, 0.0, 0.0), (0.0, 0.0, -47.0)):  # a wrong place; heights above the sea
        made, anchors = three_drives(0.02, 0.02, shift_m)
        answer = optimise(made.graph, anchors=anchors)
        (told,) = answer.georeferences[0].sessions
        assert told.session == "s0" and told.elsewhere and told.sigma_factor == 1.0
        assert np.allclose(told.offset_m, shift_m, atol=1.0)
        assert held(anchors, answer, "s0") == 0.0 and min(held(anchors, answer, one) for one in ("s1", "s2")) > 0.9
        assert error_m(made, answer) < 0.7


def test_receivers_that_lie_apart_make_the_place_of_a_map_less_sure() -> None:
    made = fleet(5, 0.0, sessions=2, submaps=40, per_pair=15)
    together = fixes(made, 3, 1.5)
    apart = [replace(one, place_world=one.place_world + (5.0 * (one.node.session == "s1"), 0, 0)) for one in together]
    (good,), (torn,) = (optimise(made.graph, anchors=its).georeferences for its in (together, apart))
    assert good.sessions == () and {one.session for one in torn.sessions} == {"s0", "s1"}
    more = np.trace((torn.covariance - good.covariance)[:3, :3])
    assert 1.5**2 < more < 4.0**2
