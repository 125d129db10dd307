"""Submaps enter their map one after the other, and each is compared with those before it (docs/decisions/0325)."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from revisit.core.config import PipelineConfig
from revisit.service.domain.states import OperationState, SubmapState
from revisit.service.features.recognition import rows
from revisit.service.ports.job_queue import Lease
from tests.support.campaigns import sizes
from tests.support.drives_on_a_road import (
    RoadRecogniser,
    drives,
    loops_of,
    post_drives,
    submaps_of,
    work_off_together,
)
from tests.support.fake_recogniser import FakeRecogniser
from tests.support.memory.vector_index import MemoryVectorIndex
from tests.support.service_world import SESSION, TENANT, World, memory_world, posted, sqlite_world, submap
from tests.support.stepped_clock import PassingClock

DRIVES, WORKERS = 8, 8
EVERY_PAIR = replace(PipelineConfig(), loop=replace(PipelineConfig().loop, candidates=1000, enough=0))


@pytest.fixture
def searches(monkeypatch):
    """The vectors that any index was searched for."""
    asked, search = [], MemoryVectorIndex.search

    def noted(index, map_number, vector, k, where):
        asked.append(vector)
        return search(index, map_number, vector, k, where)

    monkeypatch.setattr(MemoryVectorIndex, "search", noted)
    return asked


def leased(world: World) -> dict[tuple[str, str], Lease]:
    """Every job of a world by session and submap, each leased to a worker of its own: that of its operation."""
    leases = {}
    while (lease := world.claim(f"w{len(leases)}")) is not None:
        _, _, _, session_id, _, submap_id = lease.job.subject.split("/")
        leases[session_id, submap_id] = lease
    return leases


async def one_after_the_other(poses, order, pipeline=PipelineConfig()) -> World:
    """Another world, where one worker does the same jobs in this order."""
    world = memory_world(pipeline=pipeline)
    await post_drives(world, poses)
    leases, worker = leased(world), world.worker(RoadRecogniser())
    for one in order:
        worker.run(leases[one.session_id, one.submap_id])
    return world


@pytest.mark.parametrize("pipeline", [EVERY_PAIR, PipelineConfig()], ids=["every pair", "as shipped"])
@pytest.mark.parametrize("submaps", sizes("ENTRIES", 32, 120))
@pytest.mark.timeout(3600)
async def test_eight_workers_in_one_map_find_what_one_finds_in_the_order_of_entry(
    tmp_path, searches, pipeline, submaps
):
    poses = drives(DRIVES, submaps // DRIVES)
    world = sqlite_world(tmp_path, pipeline=pipeline)
    await post_drives(world, poses)
    recogniser = RoadRecogniser()
    work_off_together(world, WORKERS, recogniser)
    order, found = submaps_of(world), loops_of(world)
    assert all(one.state == SubmapState.DESCRIBED and one.searched for one in order)
    assert recogniser.described == submaps and len(searches) <= 1.05 * submaps
    assert found == loops_of(await one_after_the_other(poses, order, pipeline))
    if pipeline is EVERY_PAIR:
        names = [(one.session_id, one.submap_id) for one in order]
        pairs = {(later, sooner) for sooner, later in itertools.combinations(names, 2) if sooner[0] != later[0]}
        assert {ends for ends in found if ends[0][0] != ends[1][0]} == pairs
    world.context.transactions.close()


class WorkerEnds(BaseException):
    """The end of a worker process, wherever it stands."""


class Ends(FakeRecogniser):
    """Describes, and ends its worker where a pair is compared."""

    def __init__(self) -> None:
        self.described = 0

    def describe(self, given, config):
        self.described += 1
        return super().describe(given, config)

    def verify(self, query, match, similarity, config, initial=None):
        raise WorkerEnds


def ends(*_):
    raise WorkerEnds


def kill_in_search(world: World, monkeypatch) -> Ends:
    recogniser = Ends()
    with pytest.raises(WorkerEnds):
        world.worker(recogniser).run(world.claim())
    return recogniser


def kill_before_the_end(world: World, monkeypatch) -> FakeRecogniser:
    monkeypatch.setattr(rows.LoopCommit, "__call__", ends)
    with pytest.raises(WorkerEnds):
        world.worker().run(world.claim())
    monkeypatch.undo()
    return FakeRecogniser()


@pytest.mark.parametrize("kill", [kill_in_search, kill_before_the_end])
async def test_a_run_that_finds_its_submap_entered_goes_on_from_the_stored_description(monkeypatch, kill):
    world = memory_world()
    await posted(world, a=1, b=30, c=1)
    for _ in range(2):
        world.worker().run(world.claim())
    kill(world, monkeypatch)
    (entered,) = [one for one in submaps_of(world) if not one.searched]
    assert (entered.submap_id, entered.state) == ("c", SubmapState.DESCRIBED)
    world.clock.ms += world.context.policy.lease_ms
    monkeypatch.setattr(FakeRecogniser, "describe", ends)
    assert world.work_off() == 1
    accepted = [pair for pair, verdict in loops_of(world).items() if verdict[0] == "ACCEPTED"]
    assert accepted == [(("monday", "c"), ("monday", "a"))]
    assert [one.searched for one in submaps_of(world)] == [True] * 3


class Fails(FakeRecogniser):
    def verify(self, query, match, similarity, config, initial=None):
        raise RuntimeError("the method has a fault")


async def test_a_submap_that_cannot_be_compared_leaves_the_map_again():
    world = memory_world(max_attempts=1)
    await posted(world, a=1, b=30)
    world.work_off()
    await world.use_cases.posting.post(TENANT, submap("c", 60))
    world.work_off(Fails())
    failed = next(one for one in submaps_of(world) if one.state == SubmapState.FAILED)
    assert (failed.submap_id, failed.descriptor, failed.failure_code) == ("c", None, "INTERNAL")
    await world.use_cases.posting.post(TENANT, submap("d", 90))
    world.work_off()
    assert {match for query, match in loops_of(world) if query == ("monday", "d")} == {("monday", "a"), ("monday", "b")}
    await world.use_cases.dead_letters.retry(TENANT, failed.operation_id)
    world.work_off()
    assert ("monday", "d") in {match for query, match in loops_of(world) if query == ("monday", "c")}


class EndsHere(RoadRecogniser):
    """Describes, and ends its worker where a pair is compared."""

    verify = ends


async def two_drives(world: World) -> dict[tuple[str, str], Lease]:
    """Two drives are posted and every job is leased; the loops of the first drive are found."""
    poses = drives(2, 6)
    await post_drives(world, poses)
    leases, (first, _) = leased(world), (session.session_id for session in poses)
    worker = world.worker(RoadRecogniser())
    for number in range(6):
        worker.run(leases[first, f"s{number:04d}"])
    return leases


async def test_loops_wait_for_those_that_decide_about_them_also_where_a_worker_ends():
    world = memory_world()
    leases = await two_drives(world)
    before, after = leases["drive-1", "s0002"], leases["drive-1", "s0003"]
    with pytest.raises(WorkerEnds):
        world.worker(EndsHere()).run(before)
    world.context.transactions.write(lambda uow: uow.queue.release(before.job.lease_owner, "it ended")).result()
    world.worker(RoadRecogniser()).run(after)
    operation = await world.use_cases.operations.get(TENANT, after.job.operation_id)
    assert (operation.state, operation.attempts) == (OperationState.QUEUED, 0)
    assert not any(query == ("drive-1", "s0003") for query, _ in loops_of(world))
    world.clock.ms += 2 * world.context.policy.lease_ms
    world.work_off(RoadRecogniser())
    order = submaps_of(world)
    assert all(one.searched for one in order)
    assert loops_of(world) == loops_of(await one_after_the_other(drives(2, 6), order))


async def test_a_run_waits_for_one_that_is_gone_until_the_lease_of_that_ends_and_comes_right_behind_it():
    world = memory_world(PassingClock())
    leases = await two_drives(world)
    before, after = leases["drive-1", "s0002"], leases["drive-1", "s0003"]
    with pytest.raises(WorkerEnds):
        world.worker(EndsHere()).run(before)
    began_ms, lease_ms = world.clock.ms, world.context.policy.lease_ms
    worker = world.worker(RoadRecogniser())
    worker.run(after)
    assert lease_ms <= world.clock.ms - began_ms <= 1.1 * lease_ms
    due = leased(world)
    assert "s0002" in (submaps := [submap_id for _, submap_id in due]) and "s0003" not in submaps
    worker.run(due["drive-1", "s0002"])
    world.clock.ms += 500
    worker.run(world.claim())
    entered = [one for one in submaps_of(world) if one.session_id == "drive-1" and one.entered]
    assert [(one.submap_id, one.searched) for one in entered] == [("s0002", True), ("s0003", True)]


async def test_a_session_that_still_searches_for_loops_does_not_say_that_it_has_none(monkeypatch):
    world = memory_world()
    await posted(world, a=1, b=30)
    world.worker().run(world.claim())
    kill_before_the_end(world, monkeypatch)
    await world.use_cases.sessions.finish(TENANT, SESSION)
    assert (await world.use_cases.sessions.get(TENANT, SESSION)).no_loops is None
    world.clock.ms += world.context.policy.lease_ms
    world.work_off()
    assert (await world.use_cases.sessions.get(TENANT, SESSION)).no_loops.code == "NONE_ACCEPTED"
