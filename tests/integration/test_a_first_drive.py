"""The first drive of a team, recorded once, in a service as it comes: it has its loops, or says why not."""

from __future__ import annotations

from dataclasses import replace

import pytest

from revisit.service.domain.policy import Policy
from revisit.service.domain.states import LoopState
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.ingest.calls import AppendScan
from revisit.service.features.resources.paging import PageRequest
from revisit.service.use_cases import UseCases
from tests.support.service_world import SESSION, TENANT, World, cloud, memory_world, pose


@pytest.fixture
def service() -> World:
    """A service as it comes: nothing is set."""
    world = memory_world()
    context = replace(world.context, policy=Policy())
    return replace(world, context=context, use_cases=UseCases.over(context, "test"))


async def driven(service: World, ways_m: list[int]) -> set[tuple[int, int]]:
    """Stream a scan for each metre of a way along a line, by its positions; the loops, by the ordinals."""
    await service.use_cases.maps.create(TENANT, CreateMap(SESSION.map_id))
    await service.use_cases.sessions.create(TENANT, CreateSession(SESSION.map_id, SESSION.session_id))
    for seq, x_m in enumerate(ways_m, 1):
        await service.use_cases.scans.append(TENANT, AppendScan(SESSION, seq, seq * 100, pose(float(x_m)), cloud(x_m)))
    await service.use_cases.sessions.finish(TENANT, SESSION)
    service.work_off()
    found = await service.use_cases.loops.list(TENANT, SESSION.map_id, PageRequest(), state=LoopState.ACCEPTED)
    ordinals = {}
    for loop in found.items:
        for key in (loop.query, loop.match):
            ordinals[key] = (await service.use_cases.submaps.get(TENANT, key)).ordinal
    return {(ordinals[loop.query], ordinals[loop.match]) for loop in found.items}


@pytest.mark.parametrize("length_m", [20, 50, 100])
async def test_a_way_driven_there_and_back_has_its_loops(service, length_m):
    """The same ten metres make the same submap, whichever way they are driven."""
    there_and_back = [*range(length_m + 1), *range(length_m - 1, -1, -1)]
    last, at_the_turn = 2 * length_m // 5 - 2, length_m // 5 - 1
    # The submaps just before and just behind the turn are no loop: that place was not left.
    same_places = {(query, last - query) for query in range(at_the_turn + 2, last + 1)}
    assert await driven(service, there_and_back) == same_places
    assert (await service.use_cases.sessions.get(TENANT, SESSION)).no_loops is None


async def test_a_street_driven_once_has_no_loop_and_says_why(service):
    assert await driven(service, list(range(75))) == set()
    told = (await service.use_cases.sessions.get(TENANT, SESSION)).no_loops
    assert told.code == "NOTHING_TO_COMPARE"
    assert told.message.startswith("14 submaps: the drive came back to no place that it had left by 5 m")
