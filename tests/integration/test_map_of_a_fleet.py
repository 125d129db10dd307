"""A simulated fleet through the service: three drives with drift and unknown starts become one map. Also by itself."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from revisit import Client
from revisit.core.pose_graph.graph import PoseGraph
from revisit.core.pose_graph.optimisation import Robustness, optimise
from revisit.service.adapters.core_map_optimiser import CoreMapOptimiser
from revisit.service.domain.identity import SessionKey
from revisit.service.failpoints import FailpointReached, arm
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.graph import posting as optimisation_posting
from revisit.service.features.graph.posting import drop_waiting
from revisit.service.features.resources.paging import PageRequest
from revisit.service.features.upkeep.sweeping import UNREFERENCED_S, collect
from revisit.service.ports.blobs import TILE_BLOB
from tests.support.fake_tiler import FakeTiler
from tests.support.fleet_in_service import fleet_in
from tests.support.live_service import live_service
from tests.support.patience import PATIENCE_S
from tests.support.service_world import TENANT, answered, described, memory_world, open_session, submap


def clean_error_m(fleet) -> float:
    """Of the graph without its wrong loops, optimised plainly."""
    right = [loop for loop in fleet.graph.loops if loop.name.startswith("right")]
    graph = PoseGraph.of(list(fleet.graph.trajectories), right)
    return fleet.error_m(optimise(graph, Robustness.PLAIN).T_map_submap)


@pytest.fixture(scope="module")
def running():
    with live_service() as service, Client(service.http) as client:
        yield service, client


@pytest.mark.parametrize("wrong_share", [0.1, 0.3, 0.5])
def test_wrong_loops_are_set_aside_and_right_ones_kept(running, wrong_share):
    service, client = running
    made = fleet_in(service.world, f"wrong-{wrong_share}", wrong_share)
    done = client.wait(client.optimise_map(made.name))
    kept = {loop.name for loop in client.loop_closures(made.name, graph_state="IN_MAP")}
    assert kept <= made.right()
    assert len(kept) >= 0.95 * len(made.right())
    assert done.result["frames"] == 1
    error_m = made.fleet.error_m(made.poses(client.submap_poses(done.result["version"])))
    odometry_m = made.fleet.error_m({one.session: one.T_odom_submap for one in made.fleet.graph.trajectories})
    assert odometry_m > 30.0
    assert error_m <= 1.1 * clean_error_m(made.fleet)


def test_corrections_put_the_odometry_of_every_robot_into_one_frame(running):
    service, client = running
    made = fleet_in(service.world, "frames")
    client.wait(client.optimise_map(made.name))
    corrections = {name: client.correction(f"{made.name}/sessions/{name}") for name in made.fleet.truth}
    assert len({correction.frame for correction in corrections.values()}) == 1
    corrected = {
        one.session: corrections[one.session].T_map_odom @ one.T_odom_submap for one in made.fleet.graph.trajectories
    }
    assert made.fleet.error_m(corrected) < 20.0


def waiting(world):
    queued = world.context.transactions.read(lambda uow: uow.jobs.find(TENANT, state="QUEUED", kind="OPTIMISE_MAP"))
    return queued.result()


async def test_a_map_is_optimised_by_itself_once_its_new_loops_have_settled():
    world = memory_world(optimise_after_loops=1, optimise_delay_ms=5000)
    await open_session(world)
    for name, place in (("a", 1), ("b", 2), ("c", 1), ("d", 1)):
        await world.use_cases.posting.post(TENANT, submap(name, place))
    await world.use_cases.sessions.create(TENANT, CreateSession("town", "tuesday"))
    # It meets b, and is compared with the others in vain.
    await world.use_cases.posting.post(TENANT, submap("e", 2, SessionKey("town", "tuesday")))
    world.work_off()
    (job,) = waiting(world)
    assert world.work_off() == 0
    world.clock.ms += 4999
    assert world.work_off() == 0
    world.clock.ms += 1
    assert world.work_off() == 2  # and recall (docs/decisions/0090)
    assert (await world.use_cases.operations.get(TENANT, job.operation_id)).result["version"] == "maps/town/versions/1"
    assert waiting(world) == []


async def test_the_loops_of_a_large_map_settle_longer(monkeypatch):
    monkeypatch.setattr(optimisation_posting, "LOOPS_A_DELAY", 1)
    world = memory_world(optimise_after_loops=1, optimise_delay_ms=5000)
    await described(world, a=1, b=2, c=1)
    accepted = world.context.transactions.read(lambda uow: uow.loops.count(TENANT, state="ACCEPTED")).result()
    (job,) = waiting(world)
    assert accepted > 0
    assert job.not_before_ms - world.clock.ms == (1 + accepted) * 5000


async def test_a_map_waits_for_as_many_loops_as_the_operator_says():
    world = memory_world(optimise_after_loops=3)
    await described(world, a=1, b=2, c=1)
    assert waiting(world) == []
    await described(world, d=1, e=1)
    assert len(waiting(world)) == 1


async def test_somebody_who_asks_does_not_wait_for_the_loops_to_settle():
    world = memory_world(optimise_after_loops=1)
    await described(world, a=1, b=2, c=1)
    (job,) = waiting(world)
    posted = await world.use_cases.map_versions.optimise(TENANT, "town")
    assert (posted.operation.operation_id, posted.replay) == (job.operation_id, True)
    assert world.work_off() == 1


async def test_only_the_newest_versions_are_kept_with_their_operations():
    world = memory_world(map_versions_kept=2)
    await described(world, a=1, b=2, c=1)
    operations = []
    for _ in range(3):
        operations.append((await world.use_cases.map_versions.optimise(TENANT, "town")).operation.operation_id)
        world.work_off()
    found = world.context.transactions.read(lambda uow: uow.map_versions.find(TENANT)).result()
    assert [version.version for version in found] == [2, 3]
    jobs = world.context.transactions.read(lambda uow: uow.jobs.find(TENANT, kind="OPTIMISE_MAP")).result()
    assert [job.operation_id for job in jobs] == operations[1:]


class CountingTiler(FakeTiler):
    """No tile is like another."""

    def fuse(self, *asked):
        fused = super().fuse(*asked)
        return None if fused is None else replace(fused, neural_map=str(self.made).encode())


async def test_the_tiles_of_a_version_that_is_not_kept_are_collected_after_an_hour():
    world = replace(memory_world(map_versions_kept=1), tiler=CountingTiler())
    await described(world, a=1, b=2, c=1)
    for version in (1, 2):
        await world.use_cases.map_versions.optimise(TENANT, "town")
        world.work_off()
        tiles = await world.use_cases.map_tiles.list(TENANT, "town", version, PageRequest())
        await answered(world, world.use_cases.map_tiles.make(TENANT, tiles.items[0].key))
        await answered(world, world.use_cases.map_changes.list(TENANT, "town", version, PageRequest()))
    named = world.context.transactions.read(lambda uow: uow.map_tiles.find(TENANT)).result()
    assert {one.version for one in named} == {2}
    world.clock.ms += int(1000 * UNREFERENCED_S)
    await collect(world.context.storage)
    stored = {blob.sha256 for blob in world.context.blobs.stored(0.0) if blob.kind == TILE_BLOB}
    assert stored == {one.tile_sha256 for one in named}


async def test_a_graph_that_loses_a_session_while_it_is_optimised_is_read_again():
    world = memory_world()
    made = fleet_in(world, "lost", sessions=2, submaps=20, per_pair=6)
    posted = await world.use_cases.map_versions.optimise(TENANT, made.map_id)
    optimiser, readings = world.optimiser, []

    class Deleting(CoreMapOptimiser):
        def by_loops(self, graph, progress):
            readings.append(len(graph.tracks))
            if len(readings) == 1:
                world.context.transactions.write(lambda uow: delete_one(uow, made.map_id)).result()
            return optimiser.by_loops(graph, progress)

    world.optimiser = Deleting()
    world.work_off()
    assert readings == [2, 1]
    done = await world.use_cases.operations.get(TENANT, posted.operation.operation_id)
    assert (done.state, done.result["sessions"]) == ("DONE", 1)


def delete_one(uow, map_id):
    from revisit.service.features.deletion.rows import mark_session

    mark_session(uow, uow.maps.get(TENANT, map_id), uow.sessions.get(TENANT, map_id, "s1"), 1)


async def test_a_revert_is_not_undone_by_an_optimisation_that_was_under_way():
    world = memory_world()
    made = fleet_in(world, "held", 0.3, sessions=2, submaps=20, per_pair=6)
    cases = world.use_cases.map_versions
    for _ in range(2):
        await cases.optimise(TENANT, made.map_id)
        world.work_off()
    posted = await cases.optimise(TENANT, made.map_id)
    lease = world.claim()
    waits = await cases.optimise(TENANT, made.map_id)
    loop, optimiser = asyncio.get_running_loop(), world.optimiser

    class Reverting(CoreMapOptimiser):
        def by_loops(self, graph, progress):
            asyncio.run_coroutine_threadsafe(cases.revert(TENANT, made.map_id, 1), loop).result(PATIENCE_S)
            return optimiser.by_loops(graph, progress)

    world.optimiser = Reverting()
    await asyncio.to_thread(world.worker().run, lease)
    for operation in (posted, waits):
        ended = await world.use_cases.operations.get(TENANT, operation.operation.operation_id)
        assert (ended.state, "brought back" in ended.result["outcome"]) == ("DONE", True)
    assert (await cases.get(TENANT, made.map_id, 3)).in_force
    assert world.work_off() == 0


@pytest.mark.slow
@pytest.mark.parametrize("point", ["optimise.after_version", "optimise.after_poses"])
async def test_a_commit_that_breaks_off_leaves_the_old_version_whole(point):
    world = memory_world()
    made = fleet_in(world, "broken", 0.3, sessions=2, submaps=20, per_pair=6)
    cases = world.use_cases.map_versions
    await cases.optimise(TENANT, made.map_id)
    world.work_off()
    before = await cases.get(TENANT, made.map_id, 1)
    await cases.optimise(TENANT, made.map_id)
    arm(f"{point}=raise")
    try:
        world.work_off()
    except FailpointReached:
        pass
    finally:
        arm("")
    assert await cases.get(TENANT, made.map_id, 1) == before and before.in_force
    world.context.transactions.write(lambda uow: drop_waiting(uow, TENANT, made.map_id, {}, 1)).result()
