"""Sessions that loops would join, and surfaces do not: made-up fleets, and surfaces that say what a test wants."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import pytest

from revisit.core.merge.evidence import MergeEvidence
from revisit.core.pose_graph.graph import GraphState
from revisit.service.adapters import core_neural_maps
from revisit.service.domain.policy import Policy
from revisit.service.domain.states import LoopEventKind
from revisit.service.features.corrections.job import EarlyCorrections
from revisit.service.features.loops.rows import Change, add_loop
from revisit.service.features.merging.calls import MergeMap
from tests.support.fake_merger import FakeMerger
from tests.support.fleet_in_service import fleet_in, fleet_in_two, slipped_fleet_in
from tests.support.service_world import TENANT, memory_world

COPIES = {"s1", "s3"}


class Walled(FakeMerger):
    """Surfaces that keep the submaps of one session apart from all others; it notes what it was asked."""

    def __init__(self, alone: set[int]) -> None:
        self.alone = alone
        self.asked: list[tuple[set[int], set[int], int]] = []

    def audit(self, first, second, surfaces, scale, most, progress) -> MergeEvidence:
        """Nothing is read."""
        sides = set(first), set(second)
        self.asked.append((*sides, most))
        return MergeEvidence(5_000, 0.02, 0.01, 0.2 if self.alone in sides else 0.001)


def rows(world, name, **equals):
    return world.context.transactions.read(lambda uow: getattr(uow, name).find(TENANT, **equals)).result()


def submaps_of(world, session_id, map_id="town"):
    return {one.number for one in rows(world, "submaps", map_id=map_id, session_id=session_id)}


def driven_on(world, session_id):
    last = rows(world, "submaps", map_id="town", session_id=session_id)[-1]
    later = replace(last, submap_id=f"later-{last.number}", ordinal=last.ordinal + 1, number=0)
    world.context.transactions.write(lambda uow: uow.submaps.add(later)).result()


async def optimised(world):
    await world.use_cases.map_versions.optimise(TENANT, "town")
    assert world.work_off() == 1
    version = rows(world, "maps", map_id="town")[0].map_version
    return (await world.use_cases.map_versions.get(TENANT, "town", version)).summary


@pytest.fixture
def world():
    made = memory_world()
    fleet_in(made, "town", sessions=3, submaps=20, per_pair=8)
    made.merger = Walled(submaps_of(made, "s1"))
    return made


async def test_a_session_that_surfaces_contradict_keeps_its_frame_and_its_loops_say_why(world):
    summary = await optimised(world)
    (refused,) = summary["refused_joins"]
    assert (summary["frames"], refused["reason"], refused["seen_through_share"]) == (2, "FREE_SPACE_VIOLATED", 0.2)
    assert sorted([refused["sessions"], refused["other_sessions"]]) == [
        ["maps/town/sessions/s0", "maps/town/sessions/s2"],
        ["maps/town/sessions/s1"],
    ]
    loops = rows(world, "loops", map_id="town")
    aside = [one for one in loops if "s1" in (one.query_session_id, one.match_session_id)]
    assert refused["loops"] == len(aside) == summary["loops_set_aside"] == 16
    assert {one.graph_state for one in aside} == {GraphState.SET_ASIDE}
    events = rows(world, "loop_events", map_id="town", loop_id=aside[0].loop_id)
    assert events[-1].details == {"refusal": "FREE_SPACE_VIOLATED"}
    assert {one.graph_state for one in loops if one not in aside} == {GraphState.IN_MAP}


async def test_what_was_set_aside_by_surfaces_joins_once_they_agree(world):
    await optimised(world)
    world.merger.alone = set()
    summary = await optimised(world)
    assert (summary["frames"], summary["loops_set_aside"]) == (1, 0) and "refused_joins" not in summary


async def test_surfaces_are_asked_for_each_join_and_again_each_time_that_a_session_has_grown_by_a_tenth(world):
    world.merger.alone = set()
    for later, asked in ((0, 2), (0, 2), (1, 2), (1, 2), (1, 3), (1, 3), (1, 3), (1, 4)):
        for _ in range(later):
            driven_on(world, "s2")
        await optimised(world)
        assert len(world.merger.asked) == asked
    assert submaps_of(world, "s2") in world.merger.asked[-1]


async def test_submaps_between_the_loops_beside_a_broken_step_are_not_compared():
    """The step may be any of those, and a surface that is metres off would refuse the whole drive."""
    world = memory_world()
    slipped_fleet_in(world, "town")
    world.merger = Walled(set())
    silent = {one.number for one in rows(world, "submaps", map_id="town", session_id="s1") if 26 <= one.ordinal < 34}
    contradicted = [one for one in rows(world, "loops", map_id="town") if silent & {one.query_number, one.match_number}]
    rejected = [replace(one, state="REJECTED", reason="AMBIGUOUS", graph_state=None) for one in contradicted]
    world.context.transactions.write(lambda uow: [uow.loops.replace(one) for one in rejected] and None).result()
    (fault,) = (await optimised(world))["odometry_faults"]
    assert fault["kind"] == "SLIP" and silent
    ((first, second, _),) = world.merger.asked
    assert silent.isdisjoint(first | second)
    assert len(first) == 60 and 45 < len(second) <= 52


async def test_the_price_of_a_version_is_shared_by_its_joins():
    world = memory_world()
    fleet_in(world, "town", sessions=9, submaps=8, per_pair=4)
    world.merger = Walled(set())
    await optimised(world)
    assert [most for *_, most in world.merger.asked] == [12] * 8


async def test_a_neural_map_is_read_once_for_the_joins_of_a_version(monkeypatch):
    world, read = memory_world(), Counter()
    fleet_in(world, "town", sessions=3, submaps=8, per_pair=4)

    class Reading(Walled):
        def audit(self, first, second, surfaces, scale, most, progress) -> MergeEvidence:
            for number, T_map_submap in (first | second).items():
                surfaces(number, T_map_submap)
            return super().audit(first, second, surfaces, scale, most, progress)

        def surfaces(self, read_one):
            return super().surfaces(lambda number: read.update([number]))

    monkeypatch.setattr(core_neural_maps, "decoded", lambda _: None)
    world.merger = Reading(set())
    await optimised(world)
    assert len(world.merger.asked) == 2 and len(read) == 24 and set(read.values()) == {1}


async def test_loops_ahead_of_a_version_move_no_session_that_surfaces_keep_apart(world):
    await optimised(world)
    known = next(one for one in rows(world, "loops", map_id="town") if one.match_session_id == "s1")
    again = replace(known, loop_id="again", graph_state=None, number=0)
    inside = next(one for one in rows(world, "loops", map_id="town") if one.graph_state == GraphState.IN_MAP)
    T_match_query = (*inside.T_match_query[:3], inside.T_match_query[3] + 0.1, *inside.T_match_query[4:])
    moving = replace(inside, loop_id="moving", T_match_query=T_match_query, graph_state=None, number=0)
    transactions = world.context.transactions
    early = EarlyCorrections(transactions, world.clock, Policy(optimise_after_loops=1), world.optimiser)
    for loop, moved in ((again, set()), (moving, {"s0", "s2"})):
        transactions.write(lambda uow, loop=loop: add_loop(uow, loop, Change(LoopEventKind.VERIFIED, 1))).result()
        early.update(TENANT, "town")
        assert {one.session_id for one in rows(world, "early_corrections", map_id="town")} <= moved
    assert rows(world, "early_corrections", map_id="town")


async def test_a_merge_rests_on_no_loops_within_a_map_that_surfaces_speak_against():
    world = memory_world()
    fleet_in_two(world, ("town", "other"), sessions=4, submaps=20, per_pair=8)
    world.merger = Walled(submaps_of(world, "s1", "other"))
    posted = await world.use_cases.map_merges.merge(TENANT, MergeMap("town", "other"))
    world.work_off()
    result = (await world.use_cases.operations.get(TENANT, posted.operation.operation_id)).result
    assert result["verdict"] == "MERGED"
    (refused,) = (await world.use_cases.map_versions.get(TENANT, "town", 1)).summary["refused_joins"]
    assert [*refused["sessions"], *refused["other_sessions"]] == ["maps/town/sessions/s1", "maps/town/sessions/s3"]
    copied = [
        one for one in rows(world, "loops", map_id="town") if {one.query_session_id, one.match_session_id} == COPIES
    ]
    assert len(copied) == 8 and {one.graph_state for one in copied} == {GraphState.SET_ASIDE}
