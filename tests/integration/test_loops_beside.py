"""Ambiguous loops are decided by the loops beside them, and by nothing less (docs/decisions/0161)."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.core.verification import Authority
from revisit.service.domain.identity import SessionKey, SubmapKey
from revisit.service.domain.states import LoopState
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.resources.paging import PageRequest
from revisit.service.features.search.calls import LocalizeQuery
from tests.support.fake_recogniser import CANNOT_BE_DESCRIBED, FakeRecogniser
from tests.support.service_world import SESSION, TENANT, cloud, memory_world, open_session, sqlite_world, submap
from tests.support.verdicts import ambiguous, rejected, verified

PERIOD_M = 10.0
SECOND = SessionKey("town", "tuesday")
STATIONS = (0, 10, 20, 30, 40, 50)


@pytest.fixture(params=["memory", "sqlite"])
def world(request, tmp_path):
    made = memory_world() if request.param == "memory" else sqlite_world(tmp_path)
    yield made
    made.context.transactions.close()


class RowOfHouses(FakeRecogniser):
    """Houses every 10 m up to `end_m`: beyond, and only there, geometry tells one place from the others.

    The best pose of an ambiguous pair is a period off. A pose that is named is accepted within 40 m of the query.
    """

    def __init__(self, end_m: float) -> None:
        self._end_m = end_m

    def describe(self, given, config):
        return replace(super().describe(given, config), place=np.float64(given.T_odom_submap[0, 3]).tobytes())

    def verify(self, query, match, similarity, config, initial=None):
        at, other = (float(np.frombuffer(one)[0]) for one in (query, match))
        shifts = (at - other + PERIOD_M, at - other, at - other - PERIOD_M)
        poses = [se3.from_yaw(0.0, (shift, 0.3, 0.0)) for shift in shifts]
        if abs(at - other) > 15.0:
            return rejected()
        if initial is not None and initial.authority is Authority.DECIDES:
            return verified(initial.T_match_query, 0.8)
        if min(at, other) >= self._end_m:
            return verified(poses[1])
        return ambiguous(poses)


async def driven_twice(world, recogniser, stations=STATIONS, others=0):
    """Two drives past the same houses, each described as it comes; before each submap, one of each of `others`.

    Those are of another map, and cannot be described.
    """
    await open_session(world)
    await world.use_cases.sessions.create(TENANT, CreateSession(SECOND.map_id, SECOND.session_id))
    strange = [SessionKey("elsewhere", f"robot-{number}") for number in range(others)]
    if strange:
        await world.use_cases.maps.create(TENANT, CreateMap("elsewhere"))
    for session in strange:
        await world.use_cases.sessions.create(TENANT, CreateSession(session.map_id, session.session_id))
    for session in (SESSION, SECOND):
        for station in stations:
            for other in strange:
                strange_submap = submap(f"{session.session_id}-{station}", station, other, CANNOT_BE_DESCRIBED)
                await world.use_cases.posting.post(TENANT, strange_submap)
            await world.use_cases.posting.post(TENANT, submap(f"{session.session_id}-{station}", station, session))
        world.work_off(recogniser)
    page = await world.use_cases.loops.list(TENANT, "town", PageRequest(500), session_id=SECOND.session_id)
    return [loop for loop in page.items if loop.match.session_id == SESSION.session_id]


def shift_of(loop) -> float:
    """By how many metres the pose of a loop is off."""
    true_m = int(loop.query.submap_id.split("-")[1]) - int(loop.match.submap_id.split("-")[1])
    return float(loop.T_match_query[3]) - true_m


async def test_the_end_of_a_row_decides_the_loops_before_it(world):
    loops = await driven_twice(world, RowOfHouses(end_m=30.0))
    accepted = [loop for loop in loops if loop.state == LoopState.ACCEPTED]
    assert all(abs(shift_of(loop)) < 0.1 for loop in accepted)
    decided = {loop.query.submap_id for loop in accepted if "support" in loop.evidence}
    assert {"tuesday-20", "tuesday-10"} <= decided
    told = next(loop for loop in accepted if "support" in loop.evidence).evidence
    assert told["support"]["anchors"] >= 2 and told["support"]["along_m"] >= 15.0
    assert len(told["support"]["ruled_out"]) == 2 and "agree with this one alone" in told["support"]["words"]
    assert told["model_version"] == "fake-1"
    name = next(loop for loop in accepted if loop.query.submap_id == "tuesday-20").loop_id
    events = await world.use_cases.loop_decisions.events(TENANT, "town", name, PageRequest())
    assert [event.state for event in events.items] == [LoopState.REJECTED, LoopState.ACCEPTED]


async def test_loops_of_a_drive_do_not_depend_on_how_many_drives_of_others_are_under_way(tmp_path):
    alone = await driven_twice(memory_world(), RowOfHouses(end_m=30.0))
    busy = sqlite_world(tmp_path)
    beside = await driven_twice(busy, RowOfHouses(end_m=30.0), others=40)
    busy.context.transactions.close()
    assert [_told(loop) for loop in beside] == [_told(loop) for loop in alone]
    assert any("support" in loop.evidence for loop in alone)


def _told(loop):
    pose = loop.T_match_query
    return loop.query, loop.match, loop.state, loop.reason, pose, "support" in loop.evidence


async def test_a_row_without_an_end_stays_ambiguous(world):
    loops = await driven_twice(world, RowOfHouses(end_m=1e9))
    assert loops and not [loop for loop in loops if loop.state == LoopState.ACCEPTED]


async def test_what_lies_too_far_from_the_end_stays_ambiguous():
    world = memory_world()
    loops = await driven_twice(world, RowOfHouses(end_m=60.0), stations=range(0, 121, 10))
    decided = {int(loop.query.submap_id.split("-")[1]) for loop in loops if "support" in loop.evidence}
    assert decided and min(decided) >= 30
    assert all(abs(shift_of(loop)) < 0.1 for loop in loops if loop.state == LoopState.ACCEPTED)


async def test_what_a_person_rejected_is_left_alone():
    world, recogniser = memory_world(), RowOfHouses(end_m=30.0)
    await open_session(world)
    await world.use_cases.sessions.create(TENANT, CreateSession(SECOND.map_id, SECOND.session_id))
    for session, stations in ((SESSION, STATIONS), (SECOND, STATIONS[:3])):
        for station in stations:
            await world.use_cases.posting.post(TENANT, submap(f"{session.session_id}-{station}", station, session))
        world.work_off(recogniser)
    page = await world.use_cases.loops.list(TENANT, "town", PageRequest(500), session_id=SECOND.session_id)
    mine = next(one for one in page.items if one.match == SubmapKey("town", "monday", "monday-20"))
    await world.use_cases.loop_decisions.reject(TENANT, "town", mine.loop_id)
    for station in STATIONS[3:]:
        await world.use_cases.posting.post(TENANT, submap(f"tuesday-{station}", station, SECOND))
    world.work_off(recogniser)
    assert (await world.use_cases.loops.get(TENANT, "town", mine.loop_id)).state == LoopState.REJECTED


class EqualBlocks(FakeRecogniser):
    """Blocks every 20 m, each of which looks like every other one: a pair is accepted wherever its blocks meet."""

    def describe(self, given, config):
        return replace(super().describe(given, config), place=np.float64(given.T_odom_submap[0, 3]).tobytes())

    def verify(self, query, match, similarity, config, initial=None):
        at, other = (float(np.frombuffer(one)[0]) for one in (query, match))
        shift = (at - other + 10.0) % 20.0 - 10.0
        return verified(se3.from_yaw(0.0, (shift, 0.3, 0.0)))


async def test_accepted_loops_that_contradict_each_other_are_ambiguous(world):
    loops = await driven_twice(world, EqualBlocks())
    assert len(loops) == len(STATIONS) ** 2
    assert {(loop.state, loop.reason) for loop in loops} == {(LoopState.REJECTED, "AMBIGUOUS")}
    measured = loops[0].evidence["measurement"]["rivals"]
    told = loops[0].evidence["doubts"]["PAIRWISE_INCONSISTENT"]["words"]
    assert measured and "loops beside it that say otherwise" in told


class TwoEqualSpots(EqualBlocks):
    """What lies at 0 m looks like what lies at 200 m, and nothing else like anything."""

    def verify(self, query, match, similarity, config, initial=None):
        places = {float(np.frombuffer(one)[0]) for one in (query, match)}
        if places == {0.0, 200.0}:
            return super().verify(query, match, similarity, config, initial)
        return rejected()


async def test_an_accepted_loop_that_the_odometry_of_its_own_drive_refutes_is_ambiguous(world):
    await open_session(world)
    for station in range(0, 220, 20):
        await world.use_cases.posting.post(TENANT, submap(f"monday-{station}", station, SESSION))
    world.work_off(TwoEqualSpots())
    page = await world.use_cases.loops.list(TENANT, "town", PageRequest(500), session_id=SESSION.session_id)
    (loop,) = [loop for loop in page.items if loop.T_match_query is not None]
    assert (loop.state, loop.reason) == (LoopState.REJECTED, "AMBIGUOUS")
    told = loop.evidence["doubts"]["ODOMETRY_INCONSISTENT"]["words"]
    assert told.endswith("is 200 m off by the odometry of its own drive")
    assert loop.evidence["measurement"]["rivals"][0]["T_match_query"][0][3] == pytest.approx(200.0)


async def test_a_later_loop_that_contradicts_an_earlier_one_takes_its_acceptance_back(world):
    await open_session(world)
    await world.use_cases.sessions.create(TENANT, CreateSession(SECOND.map_id, SECOND.session_id))
    await world.use_cases.posting.post(TENANT, submap("monday-0", 0, SESSION))
    states = []
    for station in (0, 20):
        await world.use_cases.posting.post(TENANT, submap(f"tuesday-{station}", station, SECOND))
        world.work_off(EqualBlocks())
        page = await world.use_cases.loops.list(TENANT, "town", PageRequest(500), session_id=SECOND.session_id)
        states.append([loop.state for loop in page.items if loop.match.session_id == SESSION.session_id])
    assert states == [[LoopState.ACCEPTED], [LoopState.REJECTED, LoopState.REJECTED]]


async def test_a_cloud_that_fits_at_two_spots_of_a_drive_is_not_localised():
    world, recogniser = memory_world(), EqualBlocks()
    await open_session(world)
    await world.use_cases.posting.post(TENANT, submap("monday-0", 0, SESSION))
    bests = []
    for station in (20, 40):
        world.work_off(recogniser)
        asked = world.use_cases.searches.localize(TENANT, LocalizeQuery("town", cloud(1)))
        answer = asyncio.create_task(asked)
        while not answer.done():
            await asyncio.sleep(0.01)
            await asyncio.to_thread(world.work_off, recogniser)
        bests.append((await answer).best)
        reasons = {candidate.reason for candidate in (await answer).candidates}
        await world.use_cases.posting.post(TENANT, submap(f"monday-{station}", station, SESSION))
    assert bests[0] is not None and bests[1] is None
    assert reasons == {"AMBIGUOUS"}
