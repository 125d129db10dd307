"""Where places may repeat, a loop is PROPOSED until its chain has decided, and acts on nothing."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.core.verification import Authority
from revisit.service.domain.identity import SessionKey
from revisit.service.domain.states import EventKind, LoopState, OperationKind, OperationState
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.resources.paging import PageRequest
from tests.support.fake_recogniser import CANNOT_BE_DESCRIBED, FakeRecogniser
from tests.support.service_world import SESSION, TENANT, memory_world, open_session, sqlite_world, submap
from tests.support.verdicts import ambiguous, rejected, verified

PERIOD_M = 12.0
SECOND = SessionKey("town", "tuesday")
AWAITED = (LoopState.PROPOSED, "AWAITS_CHAIN")
ACCEPTED = (LoopState.ACCEPTED, None)


@pytest.fixture(params=["memory", "sqlite"])
def world(request, tmp_path):
    made = memory_world() if request.param == "memory" else sqlite_world(tmp_path)
    yield made
    made.context.transactions.close()


class Shelves(FakeRecogniser):
    """Two submaps of one spot are a loop; two neighbours, 10 m apart, fit at several poses, none of them right."""

    def describe(self, given, config):
        return replace(super().describe(given, config), place=np.float64(given.T_odom_submap[0, 3]).tobytes())

    def verify(self, query, match, similarity, config, initial=None):
        at, other = (float(np.frombuffer(one)[0]) for one in (query, match))
        if abs(at - other) < 1.0:
            return verified(se3.from_yaw(0.0, (at - other, 0.3, 0.0)))
        poses = [se3.from_yaw(0.0, (at - other + shift, 0.3, 0.0)) for shift in (PERIOD_M, -PERIOD_M)]
        named = initial is not None and initial.authority is Authority.DECIDES
        return ambiguous(poses, overlap=0.3) if abs(at - other) < 15.0 and not named else rejected()


async def driven(world, *stations: int, points: int = 300) -> None:
    """The second drive goes on."""
    for station in stations:
        await world.use_cases.posting.post(TENANT, submap(f"tuesday-{station}", station, SECOND, points))
    world.work_off(Shelves())


async def a_known_aisle(world, upto: int = 41) -> None:
    """The first drive, and the beginning of the second."""
    await open_session(world)
    await world.use_cases.sessions.create(TENANT, CreateSession(SECOND.map_id, SECOND.session_id))
    for station in range(0, upto, 10):
        await world.use_cases.posting.post(TENANT, submap(f"monday-{station}", station, SESSION))
    world.work_off(Shelves())


async def verdicts(world) -> list[tuple[str, str | None]]:
    """State and reason of the right loops, by the order of their queries."""
    page = await world.use_cases.loops.list(TENANT, "town", PageRequest(500), session_id=SECOND.session_id)
    same = [loop for loop in page.items if loop.query.submap_id.split("-")[1] == loop.match.submap_id.split("-")[1]]
    return [(loop.state, loop.reason) for loop in same]


def told_of(world) -> list[str]:
    """The loops that the events of the map have told of, accepted ones."""
    rows = world.context.transactions.read(lambda uow: uow.events.following(TENANT, "town", 0, 500)).result()
    subjects = {row.subject for row in rows if row.kind == EventKind.LOOP_CLOSURE}
    found = world.context.transactions.read(lambda uow: uow.loops.find(TENANT, map_id="town")).result()
    return [loop.query.submap_id for loop in found if loop.loop_id in subjects and loop.reason in (None, AWAITED[1])]


def withdrawn(world) -> list[str]:
    """The loops that the last events of the map have told of and that are accepted no longer."""
    rows = world.context.transactions.read(lambda uow: uow.events.following(TENANT, "town", 0, 500)).result()
    subjects = [row.subject for row in rows if row.kind == EventKind.LOOP_CLOSURE]
    found = world.context.transactions.read(lambda uow: uow.loops.find(TENANT, map_id="town")).result()
    return [loop.query.submap_id for loop in found if subjects.count(loop.loop_id) == 2 and loop.reason == "AMBIGUOUS"]


def optimisations(world) -> int:
    count = world.context.transactions.read(
        lambda uow: uow.jobs.count(TENANT, kind=OperationKind.OPTIMISE_MAP.value, state=OperationState.QUEUED.value)
    )
    return int(count.result())


async def test_it_waits_and_nobody_acts_on_it(world):
    await a_known_aisle(world)
    await driven(world, 0, 10, 20)
    assert await verdicts(world) == [AWAITED] * 3
    assert told_of(world) == [] and optimisations(world) == 0
    view = await world.use_cases.sessions.get(TENANT, SECOND)
    assert view.no_loops is None


async def test_thirty_metres_of_agreeing_loops_decide(world):
    await a_known_aisle(world)
    await driven(world, 0, 10, 20, 30)
    assert await verdicts(world) == [ACCEPTED] * 4
    assert told_of(world) == ["tuesday-0", "tuesday-10", "tuesday-20", "tuesday-30"]


async def test_eighty_metres_of_drive_decide_though_nothing_there_looks_alike(world):
    await a_known_aisle(world)
    await driven(world, 0, 10)
    await driven(world, *range(100, 180, 10))
    assert await verdicts(world) == [ACCEPTED] * 2


async def test_the_end_of_the_session_decides(world):
    await a_known_aisle(world)
    await driven(world, 0, 10)
    await world.use_cases.sessions.finish(TENANT, SECOND)
    assert await verdicts(world) == [ACCEPTED] * 2


@pytest.mark.parametrize("points", [300, CANNOT_BE_DESCRIBED])
async def test_of_a_session_that_ends_before_its_last_submap_that_one_decides(world, points):
    await a_known_aisle(world)
    await driven(world, 0, 10)
    await world.use_cases.posting.post(TENANT, submap("tuesday-20", 20, SECOND, points))
    await world.use_cases.sessions.finish(TENANT, SECOND)
    assert await verdicts(world) == [AWAITED] * 2
    world.work_off(Shelves())
    assert await verdicts(world) == [ACCEPTED] * (3 if points == 300 else 2)


async def test_a_person_may_decide_first(world):
    await a_known_aisle(world)
    await driven(world, 0, 10)
    page = await world.use_cases.loops.list(TENANT, "town", PageRequest(500), state=LoopState.PROPOSED)
    first, second = (loop.loop_id for loop in page.items)
    await world.use_cases.loop_decisions.accept(TENANT, "town", first)
    await world.use_cases.loop_decisions.reject(TENANT, "town", second)
    await world.use_cases.sessions.finish(TENANT, SECOND)
    assert await verdicts(world) == [ACCEPTED, (LoopState.REJECTED, "OVERRULED")]
    reverted = await world.use_cases.loop_decisions.revert(TENANT, "town", second)
    assert (reverted.state, reverted.reason) == ACCEPTED


class EqualBlocks(Shelves):
    """Blocks every 20 m that look alike: a pair passes wherever its blocks meet, and no pose but its own fits it."""

    def verify(self, query, match, similarity, config, initial=None):
        at, other = (float(np.frombuffer(one)[0]) for one in (query, match))
        return verified(se3.from_yaw(0.0, ((at - other + 10.0) % 20.0 - 10.0, 0.3, 0.0)))


async def test_a_loop_that_is_withdrawn_after_all_takes_its_corrections_with_it(world):
    await a_known_aisle(world, upto=1)
    edits = []
    for station in (0, 20):
        await world.use_cases.posting.post(TENANT, submap(f"tuesday-{station}", station, SECOND))
        world.work_off(EqualBlocks())
        edits.append(world.context.transactions.read(lambda uow: uow.maps.get(TENANT, "town").graph_edits).result())
    assert edits == [0, 1]
    assert "tuesday-0" in withdrawn(world)


async def test_a_watch_tells_of_it_once_it_is_accepted(world):
    await a_known_aisle(world)
    await driven(world, 0, 10)
    await driven(world, 60)
    watch = aiter(world.use_cases.loops.watch(TENANT, "town", session_id=SECOND.session_id))
    told = asyncio.create_task(anext(watch))
    await asyncio.sleep(0.05)
    assert not told.done()
    await world.use_cases.sessions.finish(TENANT, SECOND)
    found = [await told, await anext(watch)]
    assert [loop.query.submap_id for loop in found] == ["tuesday-0", "tuesday-10"]
    await watch.aclose()
