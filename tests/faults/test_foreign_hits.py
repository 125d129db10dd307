"""Among the hits of many searches there is none of another tenant, whose maps have the same names and places (P19)."""

from __future__ import annotations

import asyncio
import random
from dataclasses import replace

import numpy as np
import pytest

from revisit.core.errors import RevisitError
from revisit.service.domain.identity import SubmapKey, TenantId
from revisit.service.features.index.answers import SearchCriteria
from tests.support.campaigns import Campaign, sizes
from tests.support.fake_recogniser import BINS
from tests.support.service_world import SESSION, World, open_session, sqlite_world, submap

TENANTS = [TenantId(name) for name in ("anna", "bert", "carl")]
EVERYTHING = SearchCriteria(k=100)
TURN = 50


@pytest.fixture
def world(folder):
    """Each tenant has a town, a Monday, and five submaps of the same five places under ids of its own."""
    made = sqlite_world(folder / "home")
    for tenant in TENANTS:
        asyncio.run(_fill(made, tenant))
    made.work_off()
    yield made
    made.context.transactions.close()


async def _fill(world: World, tenant: TenantId) -> None:
    await open_session(world, tenant=tenant)
    for place in range(1, 6):
        await world.use_cases.posting.post(tenant, submap(f"{tenant}-{place}", place))


async def search(world: World, tenant: TenantId, rng: random.Random) -> bool:
    """One search in the tenant's town; whether it brought what it must. Every tenth asks for a foreign submap."""
    searches = world.use_cases.searches
    if rng.random() < 0.1:
        other = rng.choice([name for name in TENANTS if name != tenant])
        key = SubmapKey(SESSION.map_id, SESSION.session_id, f"{other}-{rng.randint(1, 5)}")
        try:
            await searches.by_submap(tenant, key, EVERYTHING)
        except RevisitError as error:
            return error.code == "NOT_FOUND"
        return False
    vector = np.array([rng.random() for _ in range(BINS)], dtype=np.float32)
    criteria = replace(EVERYTHING, k=rng.randint(5, 100))
    found = await searches.by_descriptor(tenant, SESSION.map_id, vector, "fake-1", criteria)
    return {hit.submap.submap_id for hit in found.hits} == {f"{tenant}-{place}" for place in range(1, 6)}


@pytest.mark.parametrize("queries", sizes("FOREIGN_QUERIES", 200, 1_000_000))
@pytest.mark.timeout(7200)
def test_no_search_of_many_finds_a_submap_of_another_tenant(world, queries):
    rng, campaign = random.Random(19), Campaign("P19", queries)

    async def ask() -> None:
        while not campaign.over:
            turn = [search(world, rng.choice(TENANTS), rng) for _ in range(min(TURN, campaign.left))]
            assert all(await asyncio.gather(*turn))
            campaign.done += len(turn)

    asyncio.run(ask())
    campaign.publish("0 foreign submaps among the hits, every foreign id NOT_FOUND")
