"""What versions of a map say once submaps and sessions of theirs are deleted. A made-up fleet."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.service.domain.identity import SessionKey, SubmapKey
from revisit.service.features.graph.session_poses import unpack_loops
from revisit.service.features.resources.paging import PageRequest
from tests.support.fleet_in_service import fleet_in
from tests.support.service_world import TENANT, memory_world, sqlite_world

KEPT = 5
"""Of so many submaps one stays."""


@pytest.fixture(params=["memory", "sqlite"])
async def world(request, tmp_path):
    made = memory_world() if request.param == "memory" else sqlite_world(tmp_path)
    fleet_in(made, "town", 0.2, sessions=3, submaps=20, per_pair=12)
    for _ in range(2):
        await made.use_cases.map_versions.optimise(TENANT, "town")
        made.work_off()
    yield made
    if request.param == "sqlite":
        made.context.transactions.close()


def rows(world, name):
    return world.context.transactions.read(lambda uow: getattr(uow, name).find(TENANT, map_id="town")).result()


async def poses(world, version):
    page = await world.use_cases.map_versions.poses(TENANT, "town", version, PageRequest(100))
    return {one.key: one for one in page.items}


async def all_but_some_deleted(world):
    for place, one in enumerate(rows(world, "submaps")):
        if place % KEPT:
            await world.use_cases.submaps.delete(TENANT, SubmapKey("town", one.session_id, one.submap_id))


async def test_a_version_names_and_counts_what_is_left_and_leaves_it_where_it_was(world):
    before = await poses(world, 2)
    correction = await world.use_cases.corrections.get(TENANT, SessionKey("town", "s1"))
    await all_but_some_deleted(world)
    left = {one.number: SubmapKey("town", one.session_id, one.submap_id) for one in rows(world, "submaps")}
    for version in (1, 2):
        after = await poses(world, version)
        assert after.keys() == set(left.values())
        for key, pose in after.items():
            np.testing.assert_array_equal(pose.T_map_submap, before[key].T_map_submap)
    now = await world.use_cases.corrections.get(TENANT, SessionKey("town", "s1"))
    np.testing.assert_array_equal(now.T_map_odom, correction.T_map_odom)


async def test_the_summary_and_the_verdicts_of_a_version_are_those_of_loops_and_submaps_that_are_left(world):
    await all_but_some_deleted(world)
    left = rows(world, "loops")
    for version in rows(world, "map_versions"):
        assert {one.number for one in unpack_loops(version.loops)} == {one.number for one in left}
        assert version.summary["submaps"] == len(rows(world, "submaps"))
        in_map = sum(one.graph_state == "IN_MAP" for one in left)
        assert (version.summary["loops_in_map"], version.summary["loops_set_aside"]) == (in_map, len(left) - in_map)


async def test_a_version_does_not_count_a_deleted_session(world):
    await world.use_cases.sessions.delete(TENANT, SessionKey("town", "s1"))
    for version in rows(world, "map_versions"):
        assert (version.summary["sessions"], version.summary["submaps"]) == (2, 40)
        assert {one.number for one in unpack_loops(version.loops)} == {one.number for one in rows(world, "loops")}
