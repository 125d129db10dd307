"""Sessions on different storeys are never compared, whatever their scans look like (docs/decisions/0281)."""

from __future__ import annotations

import asyncio

import pytest

from revisit.core.errors import BadField
from revisit.service.domain.errors import AlreadyExists
from revisit.service.domain.identity import SessionKey, SubmapKey
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.index.answers import SearchCriteria
from revisit.service.features.index.place_memory import PlaceMemory
from revisit.service.features.merging.calls import MergeMap
from revisit.service.features.search.calls import LocalizeQuery
from tests.support.fake_merger import EasyMerger
from tests.support.service_world import TENANT, cloud, memory_world, sqlite_world, submap

PLACES = range(3)
FIRST, SECOND = SessionKey("garage", "first"), SessionKey("garage", "second")


@pytest.fixture(params=["memory", "sqlite"])
def world(request, tmp_path):
    made = memory_world() if request.param == "memory" else sqlite_world(tmp_path)
    yield made
    made.context.transactions.close()


async def driven(world, key: SessionKey, storey: str | None) -> None:
    """A session of three places, which look the same on every storey, described."""
    await world.use_cases.maps.create(TENANT, CreateMap(key.map_id))
    await world.use_cases.sessions.create(TENANT, CreateSession(key.map_id, key.session_id, storey=storey))
    for place in PLACES:
        await world.use_cases.posting.post(TENANT, submap(f"p{place}", place, key))
    world.work_off()


def loops(world, **equals):
    return world.context.transactions.read(lambda uow: uow.loops.find(TENANT, map_id="garage", **equals)).result()


def hits(world, key: SessionKey, criteria=SearchCriteria()):
    asked = SubmapKey(key.map_id, key.session_id, "p0")
    return asyncio.run(world.use_cases.searches.by_submap(TENANT, asked, criteria))


def answered(world, question):
    """The answer to a query by cloud, whose job is run here."""

    async def ask():
        asking = asyncio.create_task(question)
        while not asking.done():
            await asyncio.to_thread(world.work_off)
            await asyncio.sleep(0.01)
        return await asking

    return asyncio.run(ask())


@pytest.mark.parametrize(
    ("storeys", "closed"),
    [
        (("B1", "B2"), False),
        (("B1", "B1"), True),
        (("B1", None), True),
        ((None, "B2"), True),
        ((None, None), True),
        (("B1", "b1"), False),
    ],
)
def test_loops_are_closed_where_both_may_be_on_one_storey(world, storeys, closed):
    for key, storey in zip((FIRST, SECOND), storeys, strict=True):
        asyncio.run(driven(world, key, storey))
    between = [one for one in loops(world) if one.query_session_id != one.match_session_id]
    assert sorted(one.query_submap_id for one in between if one.state == "ACCEPTED") == (
        [f"p{place}" for place in PLACES] if closed else []
    )
    # What is not compared is not rejected either: there is no row, nor any evidence.
    assert bool(between) is closed


def test_other_storeys_take_no_candidate_away(world):
    """Forty sessions on other storeys look just like the one that is sought: twenty candidates would all be theirs."""
    asyncio.run(driven(world, FIRST, "B1"))
    for number in range(40):
        asyncio.run(driven(world, SessionKey("garage", f"other{number:02d}"), f"+{number}"))
    asyncio.run(driven(world, SECOND, "B1"))
    found = loops(world, query_session_id="second", state="ACCEPTED")
    assert {(one.query_submap_id, one.match_session_id, one.match_submap_id) for one in found} == {
        (f"p{place}", "first", f"p{place}") for place in PLACES
    }


def test_a_submap_is_searched_for_on_the_storey_of_its_session(world):
    asyncio.run(driven(world, FIRST, "B1"))
    asyncio.run(driven(world, SECOND, "B2"))
    found = hits(world, SECOND)
    assert {hit.submap.session_id for hit in found.hits} == {"second"}
    assert (found.searched, found.on_other_storeys) == (6, 3)
    with pytest.raises(BadField, match="on the storey of its session"):
        hits(world, SECOND, SearchCriteria(storey="B1"))


@pytest.mark.parametrize(("storey", "sessions", "left_out"), [(None, {"first", "second"}, 0), ("B2", {"second"}, 3)])
def test_a_cloud_is_searched_for_where_it_is_said_to_be(world, storey, sessions, left_out):
    asyncio.run(driven(world, FIRST, "B1"))
    asyncio.run(driven(world, SECOND, "B2"))
    searches = world.use_cases.searches
    found = answered(world, searches.by_cloud(TENANT, "garage", cloud(0), SearchCriteria(storey=storey)))
    assert ({hit.submap.session_id for hit in found.hits}, found.on_other_storeys) == (sessions, left_out)
    placed = answered(world, searches.localize(TENANT, LocalizeQuery("garage", cloud(0), storey=storey)))
    assert {one.submap.session_id for one in placed.candidates} == sessions
    assert placed.on_other_storeys == left_out


@pytest.mark.parametrize(("storeys", "closed"), [(("B1", "B2"), False), (("B1", "B1"), True)])
def test_a_session_that_came_while_a_submap_was_described_is_compared_by_its_storey(
    world, monkeypatch, storeys, closed
):
    """The first worker searches before the other session is there, and commits behind it."""
    first, second = world.worker(), world.worker()

    async def waiting(key, storey):
        await world.use_cases.maps.create(TENANT, CreateMap("garage"))
        await world.use_cases.sessions.create(TENANT, CreateSession(key.map_id, key.session_id, storey=storey))
        await world.use_cases.posting.post(TENANT, submap("p0", 0, key))

    asyncio.run(waiting(FIRST, storeys[0]))
    lease = world.claim()
    recall, done = PlaceMemory.recall, []

    def meanwhile(*args, **further):
        """The other session comes, and is described, behind the first search and before its commit."""
        found = recall(*args, **further)
        if not done:
            done.append(True)
            asyncio.run(waiting(SECOND, storeys[1]))
            second.run(world.claim("w2"))
        return found

    monkeypatch.setattr(PlaceMemory, "recall", meanwhile)
    first.run(lease)
    assert bool(loops(world, state="ACCEPTED")) is closed
    assert done


@pytest.mark.parametrize(("storey", "candidates", "verdict"), [("B2", 0, "REFUSED"), ("B1", 3, "MERGED")])
def test_maps_are_merged_by_what_is_on_one_storey_and_copies_stay_on_theirs(world, storey, candidates, verdict):
    world.merger = EasyMerger()
    asyncio.run(driven(world, FIRST, "B1"))
    asyncio.run(driven(world, SessionKey("annex", "copied"), storey))
    posted = asyncio.run(world.use_cases.map_merges.merge(TENANT, MergeMap("garage", "annex")))
    world.work_off()
    report = asyncio.run(world.use_cases.operations.get(TENANT, posted.operation.operation_id)).result
    assert report["evidence"]["verified"] == candidates
    assert report["verdict"] == verdict
    if verdict == "MERGED":
        copy = asyncio.run(world.use_cases.sessions.get(TENANT, SessionKey("garage", "copied")))
        assert copy.storey == storey


def test_a_storey_is_content_of_the_session(world):
    async def created(storey):
        await world.use_cases.maps.create(TENANT, CreateMap("garage"))
        return await world.use_cases.sessions.create(TENANT, CreateSession("garage", "first", storey=storey))

    assert asyncio.run(created("B1")).session.storey == "B1"
    assert asyncio.run(created("B1")).replay
    for other in ("B2", None):
        with pytest.raises(AlreadyExists):
            asyncio.run(created(other))


@pytest.mark.parametrize("bad", ["", " ", "B1 ", " B1", "x" * 65, "B\n1", "B\x00"])
def test_what_is_no_name_of_a_storey_is_refused(bad):
    world = memory_world()
    with pytest.raises(BadField) as refused:
        asyncio.run(driven(world, FIRST, bad))
    assert refused.value.field == "storey"
    with pytest.raises(BadField, match="storey"):
        asyncio.run(world.use_cases.searches.localize(TENANT, LocalizeQuery("garage", cloud(0), storey=bad)))


@pytest.mark.parametrize("good", ["x" * 64, "-1", "Ebene Ü", "parking deck 3"])
def test_any_words_name_a_storey(good):
    world = memory_world()
    asyncio.run(driven(world, FIRST, good))
    assert asyncio.run(world.use_cases.sessions.get(TENANT, FIRST)).storey == good
