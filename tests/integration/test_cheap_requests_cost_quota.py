"""What is cheap to send and dear to read is charged to the rate limits, refused or not (P11)."""

from __future__ import annotations

import asyncio
import json
import time
from dataclasses import replace
from functools import partial

import httpx
import pytest

from revisit.core.errors import MalformedBody, UnsupportedEncoding
from revisit.formats import PLY
from revisit.service.capacity.in_flight import InFlight
from revisit.service.capacity.limits import CapacityLimits
from revisit.service.domain.errors import NotFound, RateLimited
from revisit.service.features.catalogue import downloads
from revisit.service.features.catalogue.downloads import DownloadKind
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.robots import CreateRobot
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.ingest.clouds import EncodedCloud
from revisit.service.features.resources.paging import Page, PageRequest
from revisit.service.use_cases import UseCases
from tests.support.live_service import live_service
from tests.support.service_world import SESSION, TENANT, World, described, memory_world, posted, submap

BURST_POINTS = 1_000_000
SLOWLY = CapacityLimits(client_points_per_s=100.0, burst_s=BURST_POINTS / 100.0)


@pytest.fixture
def world():
    """A service whose clients have `BURST_POINTS`, and next to nothing afterwards."""
    made = memory_world()
    context = replace(made.context, in_flight=InFlight(SLOWLY))
    return World(context, UseCases.over(context, "test"), made.clock)


async def refused(world, cloud: EncodedCloud) -> None:
    with pytest.raises(MalformedBody):
        await world.use_cases.posting.post(TENANT, replace(submap("bad", 2), cloud=cloud))


async def test_a_compressed_cloud_that_is_refused_costs_what_it_may_have_been_unpacked_to(world):
    await posted(world)
    await refused(world, EncodedCloud(b"no gzip" * 8_000, PLY, "gzip"))
    with pytest.raises(RateLimited):
        await world.use_cases.posting.post(TENANT, submap("good", 1))


async def test_a_small_cloud_that_is_refused_costs_little(world):
    await posted(world)
    for _ in range(20):
        await refused(world, EncodedCloud(b"ply\n" + b"no header\n" * 1_000, PLY))
    await world.use_cases.posting.post(TENANT, submap("good", 1))


@pytest.mark.parametrize("kind", ["maps", "sessions", "robots"])
async def test_what_stays_costs_quota_when_it_is_created_and_again_when_it_is_repeated(world, kind):
    cases = world.use_cases
    await cases.maps.create(TENANT, CreateMap("town"))
    commands = {"maps": CreateMap, "sessions": partial(CreateSession, "town"), "robots": CreateRobot}
    create = getattr(cases, kind).create
    for number in (1, 2, 3, 4, 4, 4, 4, 4, 4):
        await create(TENANT, commands[kind](f"n{number}"))
    with pytest.raises(RateLimited):
        await create(TENANT, commands[kind]("one-too-many"))


async def test_the_keypoints_of_loops_cost_quota_found_or_not(world):
    for _ in range(2):
        with pytest.raises(NotFound):
            await world.use_cases.loop_keypoints.of(TENANT, "town", "none")
    with pytest.raises(RateLimited):
        await world.use_cases.loop_keypoints.of(TENANT, "town", "none")


async def test_a_file_costs_what_it_takes_to_make(world, monkeypatch):
    """The points of a large submap keep a core busy for a while."""
    await described(world, a=1)

    def slowly(*_cloud):
        began_s = time.thread_time()
        while time.thread_time() - began_s < 0.06:
            pass
        return b"# .PCD"

    monkeypatch.setattr(downloads, "encode_pcd", slowly)
    key = submap("a", 1).key
    for _ in range(2):
        assert (await world.use_cases.submaps.download(TENANT, key, DownloadKind.POINTS)).data
    with pytest.raises(RateLimited):
        await world.use_cases.submaps.download(TENANT, key, DownloadKind.POINTS)


async def test_a_file_that_cannot_be_made_costs_what_was_tried(world):
    await described(world, a=1)
    key = submap("a", 1).key
    with pytest.raises(UnsupportedEncoding):
        await world.use_cases.submaps.download(TENANT, key, DownloadKind.POINTS, "obj")
    assert (await world.use_cases.submaps.download(TENANT, key, DownloadKind.POINTS)).data


async def test_a_list_costs_by_the_row(world):
    await posted(world, **{f"s{number}": number for number in range(40)})
    asked = [world.use_cases.submaps.list(TENANT, SESSION, PageRequest(size=40)) for _ in range(12)]
    answers = await asyncio.gather(*asked, return_exceptions=True)
    assert [type(answer) for answer in answers[:3]] == [Page] * 3
    assert [type(answer) for answer in answers[-4:]] == [RateLimited] * 4


def test_json_costs_by_the_byte_refused_or_not(world):
    body = json.dumps({"map_id": "x", "display_name": "y" * 15_000}).encode()
    with live_service(world) as running, httpx.Client(base_url=running.http, trust_env=False) as http:
        answers = [
            http.post("/v1/maps", content=body, headers={"content-type": "application/json"}) for _ in range(110)
        ]
    statuses = [answer.status_code for answer in answers]
    assert set(statuses) == {422, 429} and statuses == sorted(statuses)
    assert answers[-1].headers["retry-after"]
