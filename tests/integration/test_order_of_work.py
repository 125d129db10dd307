"""The loops of a map do not depend on which worker describes which submap when (P29)."""

from __future__ import annotations

import asyncio
import random

import pytest

from revisit.service.domain.states import LoopState
from revisit.service.features.resources.paging import PageRequest
from tests.support.campaigns import Campaign, sizes
from tests.support.service_world import TENANT, World, memory_world, open_session, submap

PLACES = (1, 2, 3, 1, 2, 3, 1, 4)
"""The place of each submap in turn; neighbours are no loop."""

LOOPS = {("s0", "s3"), ("s0", "s6"), ("s1", "s4"), ("s2", "s5"), ("s3", "s6")}


async def posted() -> World:
    world = memory_world()
    await open_session(world)
    for number, place in enumerate(PLACES):
        await world.use_cases.posting.post(TENANT, submap(f"s{number}", place))
    return world


async def loops_when_worked_off(world: World, workers: int, rng: random.Random) -> set[tuple[str, str]]:
    """The accepted pairs after `workers` have done the jobs in a random order."""
    leases = [world.claim(f"w{number}") for number in range(len(PLACES))]
    crew = [world.worker() for _ in range(workers)]
    for lease in rng.sample(leases, len(leases)):
        rng.choice(crew).run(lease)
    page = await world.use_cases.loops.list(TENANT, "town", PageRequest(), state=LoopState.ACCEPTED)
    return {tuple(sorted((loop.query.submap_id, loop.match.submap_id))) for loop in page.items}


@pytest.mark.parametrize("orders", sizes("ORDERS", 10, 1_000))
@pytest.mark.timeout(3600)
def test_any_order_and_any_number_of_workers_find_the_same_loops(orders):
    rng, campaign = random.Random(29), Campaign("P29", orders)
    for number in campaign:
        world = asyncio.run(posted())
        assert asyncio.run(loops_when_worked_off(world, 1 + number % 3, rng)) == LOOPS
    campaign.publish("orders of work on 1 to 3 workers: the same loops in all")
