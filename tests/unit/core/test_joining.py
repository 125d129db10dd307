"""Whether two groups of sessions are one map: candidates, loops, rivals, frames. Fleets are made up."""

from __future__ import annotations

import dataclasses
import tracemalloc

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.core.merge.candidates import _standardised, joining_candidates
from revisit.core.merge.evidence import (
    JoiningLoops,
    MergeEvidence,
    MergeLimits,
    MergeRefusal,
    loops_refusal,
    surfaces_refusal,
)
from revisit.core.merge.joining import joining_loops
from revisit.core.merge.overlap import pairs_in_reach, worst_stretch_share
from revisit.core.pose_graph.graph import LoopEdge, PoseGraph
from revisit.core.pose_graph.optimisation import optimise
from tests.support.made_up_fleet import fleet

SECOND = frozenset({"s1"})


@pytest.fixture(scope="module")
def made():
    return fleet(3, 0.0, sessions=2, submaps=30, per_pair=12)


def elsewhere(loop: LoopEdge, shift_m: float) -> LoopEdge:
    """The loop as it would be at a place that looks the same, `shift_m` aside in the second drive's own frame."""
    return dataclasses.replace(
        loop, name=f"alias-{loop.name}", T_match_query=loop.T_match_query @ se3.from_yaw(0.0, (0, 0, shift_m))
    )


def test_loops_that_agree_join_and_span_the_common_track(made):
    found = joining_loops(made.graph, optimise(made.graph), SECOND)
    assert (found.loops, found.rival_loops) == (12, 0)
    travelled = np.linalg.norm(np.diff(made.graph.by_session["s1"].T_odom_submap[:, :3, 3], axis=0), axis=1).sum()
    assert 0.3 * travelled < found.common_track_m < travelled
    assert found.common_track_m == round(found.common_track_m, 3)  # else two steps of 5 m may not reach a limit of 10 m
    assert loops_refusal(found) is None


def test_loops_that_agree_on_another_alignment_compete(made):
    aliases = [elsewhere(loop, 40.0) for loop in made.graph.loops[:8]]
    graph = PoseGraph.of(list(made.graph.trajectories), [*made.graph.loops, *aliases])
    found = joining_loops(graph, optimise(graph), SECOND)
    assert found.loops == 12 and found.rival_loops >= 6
    assert loops_refusal(found) is MergeRefusal.ALIGNMENTS_COMPETE


def test_loops_that_only_measured_badly_are_no_rivals(made):
    worse = [elsewhere(loop, 1.0) for loop in made.graph.loops[:8]]
    graph = PoseGraph.of(list(made.graph.trajectories), [*made.graph.loops, *worse])
    assert joining_loops(graph, optimise(graph), SECOND).rival_loops == 0


def test_without_loops_nothing_joins(made):
    alone = dataclasses.replace(made.graph, loops=())
    found = joining_loops(alone, optimise(alone), SECOND)
    assert found == JoiningLoops(0, 0.0, 0)
    assert loops_refusal(found) is MergeRefusal.TOO_FEW_LOOPS
    assert loops_refusal(JoiningLoops(5, 3.0, 0)) is MergeRefusal.COMMON_TRACK_TOO_SHORT
    assert loops_refusal(JoiningLoops(5, 3.0, 0), MergeLimits().scaled(0.25)) is None


def test_the_preferred_session_gives_the_frame_and_the_poses_stay_the_same_to_each_other(made):
    first = optimise(made.graph)
    other = optimise(dataclasses.replace(made.graph, anchors=("s1",)))
    assert (first.components, other.components) == ((("s0", "s1"),), (("s1", "s0"),))
    np.testing.assert_allclose(other.T_map_submap["s1"][0], made.graph.by_session["s1"].T_odom_submap[0], atol=1e-9)
    T_other_first = other.T_map_submap["s0"][0] @ se3.inverse(first.T_map_submap["s0"][0])
    for session in ("s0", "s1"):
        np.testing.assert_allclose(T_other_first @ first.T_map_submap[session], other.T_map_submap[session], atol=1e-6)


def test_a_pair_is_a_candidate_whichever_map_asks():
    rng = np.random.default_rng(0)
    first = rng.normal(size=(30, 16)).astype(np.float32)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = first[10:22] + 0.05 * rng.normal(size=(12, 16)).astype(np.float32)
    second /= np.linalg.norm(second, axis=1, keepdims=True)
    sessions = np.full(30, 1), np.full(12, 2)
    found = joining_candidates(first, second, sessions, 2)
    back = joining_candidates(second, first, sessions[::-1], 2)
    assert {tuple(pair) for pair in found.pairs.tolist()} == {tuple(pair[::-1]) for pair in back.pairs.tolist()}
    assert {(row + 10, row) for row in range(12)} <= {tuple(pair) for pair in found.pairs.tolist()}
    assert (np.diff(found.similarities) <= 0).all()
    assert len(joining_candidates(first[:0], second, (sessions[0][:0], sessions[1]), 2).pairs) == 0


def test_places_on_different_storeys_are_no_pair_and_take_no_others_place():
    """Two storeys that look the same, and a place of which nobody knows the storey."""
    first = np.eye(4, dtype=np.float32)[[0, 0, 1]] + np.float32(0.01)
    second = first.copy()
    sessions = np.full(3, 1), np.full(3, 2)
    storeys = np.array([0, 1, 1]), np.array([0, 1, -1])
    asked = [joining_candidates(first, second, sessions, k, storeys) for k in (1, 3)]
    apart = {(0, 1), (1, 0), (2, 0)}
    pairs = [{tuple(pair) for pair in found.pairs.tolist()} for found in asked]
    assert pairs[0] >= {(0, 0), (1, 1), (2, 2)} and not pairs[0] & apart
    assert pairs[1] == {(row, column) for row in range(3) for column in range(3)} - apart
    everywhere = joining_candidates(first, second, sessions, 3)
    assert {tuple(pair) for pair in everywhere.pairs.tolist()} >= apart


def test_candidates_of_large_maps_take_bounded_memory_and_are_those_of_all_pairs_at_once():
    rng = np.random.default_rng(1)
    first, second = (rng.normal(size=(count, 8)).astype(np.float32) for count in (3000, 5000))
    sessions = np.full(3000, 1), np.full(5000, 2)
    tracemalloc.start()
    found = joining_candidates(first, second, sessions, 2)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100e6  # of all pairs the cosines alone take 60, and their order 120
    adapted = _standardised(np.concatenate([first, second]), np.concatenate(sessions))
    alike = adapted[:3000] @ adapted[3000:].T
    of_rows, of_columns = np.sort(alike, axis=1)[:, -2, None], np.sort(alike, axis=0)[-2]
    wanted = set(map(tuple, np.argwhere((alike >= of_rows) | (alike >= of_columns)).tolist()))
    assert set(map(tuple, found.pairs.tolist())) == wanted


def test_submaps_are_compared_with_their_neighbours_over_the_whole_overlap():
    line = np.column_stack([np.arange(0.0, 500.0, 5.0), np.zeros((100, 2))])
    assert pairs_in_reach(line, line + [400.0, 0, 0], 3.0) == [(80 + n, n) for n in range(20)]
    some = pairs_in_reach(line, line, 25.0, most=10)
    assert len(some) == 10 and some[0][0] == 0 and some[-1][0] == 99
    assert pairs_in_reach(line, line + [0, 900.0, 0], 25.0) == []


def overlap(*stretches: tuple[int, float]) -> tuple[np.ndarray, np.ndarray]:
    """Counts (n, 2, 2) of points and places (n, 3) of pairs 5 m apart: so many, of which each looks through a share."""
    shares = np.concatenate([np.full(pairs, share) for pairs, share in stretches])
    counts = np.stack([np.stack([np.round(1000 * shares), np.full(len(shares), 1000)], axis=1)] * 2, axis=1)
    return counts.astype(np.int64), np.arange(len(shares))[:, None] * [5.0, 0.0, 0.0]


@pytest.mark.parametrize("before", [9, 18, 60])
def test_a_short_stretch_that_differs_is_refused_however_long_the_one_that_is_alike(before: int) -> None:
    counts, places = overlap((before, 0.001), (6, 0.14), (before, 0.001))
    whole = float(counts[:, 0, 0].sum() / counts[:, 0, 1].sum())
    evidence = MergeEvidence(5_000, 0.02, 0.01, whole, worst_stretch_share=worst_stretch_share(counts, places))
    assert whole < MergeLimits().seen_through_share
    assert surfaces_refusal(evidence) is MergeRefusal.FREE_SPACE_VIOLATED


def test_one_pair_that_differs_is_no_stretch() -> None:
    counts, places = overlap((9, 0.01), (1, 0.3), (9, 0.01))
    assert worst_stretch_share(counts, places) < MergeLimits().stretch_share


def test_a_stretch_ends_where_the_way_does() -> None:
    """Two drives far apart: the last submaps of one and the first of the next are no stretch together."""
    counts, places = overlap((2, 0.2), (8, 0.01))
    places[2:] += [400.0, 0.0, 0.0]
    assert worst_stretch_share(counts, places) == pytest.approx(0.01)
    assert worst_stretch_share(counts[:0], places[:0]) == 0.0
