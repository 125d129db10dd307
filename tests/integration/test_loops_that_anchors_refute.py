"""Two drives through exact twins: loops join them, fixes on earth do not. Simulated."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from revisit.core.pose_graph.graph import GraphState
from revisit.service.domain.identity import SessionKey
from revisit.service.features.merging.calls import MergeMap
from tests.support.fake_merger import FakeMerger
from tests.support.fleet_in_service import fleet_in, fleet_in_two
from tests.support.made_up_anchors import new_anchors, with_stamps
from tests.support.service_world import TENANT, memory_world

APART_M = 260.0


def rows(world, name, **equals):
    return world.context.transactions.read(lambda uow: getattr(uow, name).find(TENANT, **equals)).result()


async def optimised(world):
    await world.use_cases.map_versions.optimise(TENANT, "town")
    world.work_off()
    version = rows(world, "maps", map_id="town")[0].map_version
    return (await world.use_cases.map_versions.get(TENANT, "town", version)).summary


def further_north(anchor):
    latitude, longitude, altitude = anchor.position
    return replace(anchor, position=(latitude + math.degrees(APART_M / 6_371_000.0), longitude, altitude))


async def test_loops_with_a_twin_are_set_aside_with_the_reason_and_return_with_the_anchors_gone():
    world = memory_world()
    made = fleet_in(world, "town", sessions=2, submaps=30, per_pair=16).fleet
    with_stamps(world)
    before = await optimised(world)
    assert before["frames"] == 1
    elsewhere = [further_north(one) for one in new_anchors(made, "s1")]
    await world.use_cases.anchors.post(TENANT, SessionKey("town", "s0"), new_anchors(made, "s0"))
    await world.use_cases.anchors.post(TENANT, SessionKey("town", "s1"), elsewhere)

    apart = await optimised(world)
    assert (apart["frames"], len(apart["georeferences"])) == (2, 2)
    crossing = [one for one in rows(world, "loops") if one.query_session_id != one.match_session_id]
    assert crossing and {one.graph_state for one in crossing} == {GraphState.SET_ASIDE}
    (*_, last) = rows(world, "loop_events", map_id="town", loop_id=crossing[0].loop_id)
    assert last.details == {"refusal": "ANCHORS_DISAGREE"}

    for one in elsewhere:
        await world.use_cases.anchors.delete(TENANT, "town", "s1", one.anchor_id)
    assert (await optimised(world))["frames"] == 1
    world.context.transactions.close()


@pytest.mark.parametrize(("is_twin", "refusal"), [(True, "ANCHORS_DISAGREE"), (False, None)])
async def test_a_merge_with_a_twin_that_lies_elsewhere_on_earth_is_refused(is_twin, refusal):
    world = memory_world()
    made = fleet_in_two(world, ("town", "other"), sessions=2, submaps=40, per_pair=0).fleet
    world.merger = FakeMerger()
    for map_id, session in (("town", "s0"), ("other", "s1")):
        with_stamps(world, map_id)
        told = new_anchors(made, session)
        if is_twin and session == "s1":
            told = [further_north(one) for one in told]
        await world.use_cases.anchors.post(TENANT, SessionKey(map_id, session), told)
    await world.use_cases.map_merges.merge(TENANT, MergeMap("town", "other", validate_only=True))
    world.work_off()
    (job,) = rows(world, "jobs", kind="MERGE_MAP")
    assert job.result["refusal"] == refusal, job.result["evidence"]
    world.context.transactions.close()
