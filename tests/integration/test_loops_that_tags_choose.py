"""Two drives where places repeat, and tags of unknown place that both saw. Simulated."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_matrix, pose_row
from revisit.core.pose_graph.graph import GraphState
from revisit.service.domain.identity import SessionKey
from revisit.service.features.merging.calls import MergeMap
from revisit.service.features.resources.paging import PageRequest
from tests.integration.test_loops_that_anchors_choose import Lattice, RepeatingTown
from tests.integration.test_loops_that_anchors_refute import optimised, rows
from tests.integration.test_recalled_loops import MAP
from tests.support.fake_merger import FakeMerger
from tests.support.fleet_in_service import fleet_in, fleet_in_two
from tests.support.made_up_anchors import seen_tags, tags_beside, with_stamps
from tests.support.service_world import TENANT, memory_world


class TaggedTown(RepeatingTown):
    async def tagged(self, tags=None, of_second=None):
        """Both drives see tags, the second one others where told."""
        first = tags_beside(self.made, "s0") if tags is None else tags
        for session, its in (("s0", first), ("s1", first if of_second is None else of_second)):
            if its:
                sightings = seen_tags(self.made, session, its)
                await self.world.use_cases.anchors.post(TENANT, SessionKey(MAP, session), sightings)
        await self.optimised(Lattice())

    async def content_hash(self):
        version = self.read(lambda uow: uow.maps.get(TENANT, MAP)).map_version
        return (await self.world.use_cases.map_versions.get(TENANT, MAP, version)).content_hash

    async def verdicts(self):
        found = []
        for session in ("s0", "s1"):
            page = await self.world.use_cases.anchors.list(TENANT, SessionKey(MAP, session), PageRequest(500))
            found += page.items
        return found

    @property
    def false(self):
        return [one for one in self.accepted if not self._is_true(one)]

    def _is_true(self, loop):
        true = pose_matrix(self.true[loop.loop_id].T_match_query)
        return np.linalg.norm((pose_matrix(loop.T_match_query) - true)[:3, 3]) < 0.5


@pytest.fixture
def town():
    made = TaggedTown(memory_world(optimise_after_loops=1))
    yield made
    made.world.context.transactions.close()


async def test_tags_that_both_drives_saw_choose_the_true_poses_and_the_drives_join(town):
    await town.tagged()
    chosen = town.accepted
    assert len(chosen) >= 8 and town.false == [] and town.frames == 1
    support = chosen[0].evidence["support"]
    assert len(support["tags"]) >= 2 and "on_earth" not in support
    assert f"tags {', '.join(support['tags'])}, seen beside both submaps, agree" in support["words"]
    states = Counter(one.state for one in await town.verdicts())
    assert states["IN_MAP"] >= 0.8 * states.total()


async def test_loops_are_ambiguous_again_once_the_tags_are_gone_and_return_with_them(town):
    await town.optimised(Lattice())
    before = await town.content_hash()
    await town.tagged()
    chosen = {one.loop_id for one in town.accepted}
    await town.without_anchors("s0", "s1")
    await town.optimised(Lattice())
    assert await town.content_hash() == before
    await town.tagged()
    assert {one.loop_id for one in town.accepted} == chosen
    await town.without_anchors("s1")
    await town.optimised(Lattice())
    assert chosen and town.accepted == [] and town.frames == 2
    assert [*town.loop(next(one for one in town.right if one.loop_id in chosen)).evidence["doubts"]] == ["SUPPORT_LOST"]
    assert {one.reason for one in await town.verdicts()} == {"SEEN_ONCE"}


async def test_a_preview_of_tags_keeps_nothing_and_a_tag_that_is_set_aside_is_an_event(town):
    tags = tags_beside(town.made, "s0")
    anchors, moved = town.world.use_cases.anchors, {**tags, "tag36h11:4": tags["tag36h11:4"] + (6.0, 0.0, 0.0)}
    await town.tagged(tags, {})
    seen = seen_tags(town.made, "s1", moved)
    asked = await anchors.preview(TENANT, SessionKey(MAP, "s1"), seen)
    town.world.work_off(Lattice())
    told = (await town.world.use_cases.operations.get(TENANT, asked.operation.operation_id)).result["anchors"]
    assert len(told) == len(seen) and {one["state"] for one in told} == {"NOT_ALIGNED"}
    assert {one["reason"] for one in told} == {"NOT_JOINED"} and len(await town.verdicts()) == 2 * len(tags)
    await anchors.post(TENANT, SessionKey(MAP, "s1"), seen)
    await town.optimised(Lattice())
    numbers = {one.record.number for one in await town.verdicts() if one.state == "SET_ASIDE"}
    events = town.read(lambda uow: uow.events.following(TENANT, MAP, 0, 1000))
    assert numbers and {int(one.subject) for one in events if one.kind == "ANCHOR"} == numbers


async def test_other_tags_join_nothing_and_one_that_was_moved_is_named(town):
    tags = tags_beside(town.made, "s0")
    await town.tagged(tags, {f"other:{tag}": place for tag, place in tags.items()})
    assert town.accepted == [] and {one.reason for one in await town.verdicts()} == {"SEEN_ONCE"}
    await town.without_anchors("s0", "s1")
    moved = {**tags, "tag36h11:4": tags["tag36h11:4"] + (6.0, 0.0, 0.0)}
    await town.tagged(tags, moved)
    assert len(town.accepted) >= 6 and town.false == []
    named = {one.record.tag: one.reason for one in await town.verdicts() if one.state == "SET_ASIDE"}
    assert named == {"tag36h11:4": "MOVED"}


async def test_tags_refute_loops_that_lie_elsewhere_until_they_are_gone():
    world = memory_world()
    made = fleet_in(world, MAP, sessions=2, submaps=30, per_pair=16).fleet
    with_stamps(world)
    await optimised(world)

    def aside(uow):
        submaps = {one.number: one for one in uow.submaps.find(TENANT, map_id=MAP)}
        for one in uow.loops.find(TENANT, map_id=MAP):
            match = submaps[one.match_number]
            T_world_match = made.truth[match.session_id][match.ordinal]
            T = se3.inverse(T_world_match) @ se3.from_yaw(0.0, (12.0, 0.0, 0.0)) @ T_world_match
            uow.loops.replace(replace(one, T_match_query=pose_row(T @ pose_matrix(one.T_match_query))))

    world.context.transactions.write(aside).result()
    assert (await optimised(world))["loops_set_aside"] == 0
    tags = tags_beside(made, "s0")
    for session in ("s0", "s1"):
        await world.use_cases.anchors.post(TENANT, SessionKey(MAP, session), seen_tags(made, session, tags))
    assert (await optimised(world))["loops_set_aside"] >= 3
    refused = [one for one in rows(world, "loops") if one.graph_state == GraphState.SET_ASIDE]
    told = [rows(world, "loop_events", map_id=MAP, loop_id=one.loop_id)[-1].details for one in refused]
    assert told == [{"refusal": "ANCHORS_DISAGREE"}] * len(refused)
    for one in rows(world, "anchors", session_id="s1"):
        await world.use_cases.anchors.delete(TENANT, MAP, "s1", one.anchor_id)
    await optimised(world)
    loops = {one.loop_id: one.graph_state for one in rows(world, "loops")}
    assert {loops[one.loop_id] for one in refused} == {GraphState.IN_MAP}
    world.context.transactions.close()


async def test_a_merge_brings_the_tags_of_the_other_map():
    world = memory_world()
    made = fleet_in_two(world, ("town", "other"), sessions=2, submaps=40, per_pair=0).fleet
    world.merger = FakeMerger()
    for map_id, session in (("town", "s0"), ("other", "s1")):
        with_stamps(world, map_id)
        told = seen_tags(made, session, tags_beside(made, "s0"))
        await world.use_cases.anchors.post(TENANT, SessionKey(map_id, session), told)
    await world.use_cases.map_merges.merge(TENANT, MergeMap("town", "other"))
    world.work_off()
    (job,) = rows(world, "jobs", kind="MERGE_MAP")
    assert job.result.get("refusal") is None, job.result
    kept = rows(world, "anchors", map_id="town")
    assert len({one.session_id for one in kept}) == 2 and {one.kind for one in kept} == {"FIDUCIAL"}
    world.context.transactions.close()
