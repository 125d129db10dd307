"""Operations that are cancelled while they run end at their next step and change nothing; their progress is told."""

from __future__ import annotations

from revisit.service.calls.operations import operation_fields
from revisit.service.features.merging.calls import MergeMap
from tests.support.fake_merger import FakeMerger
from tests.support.fleet_in_service import fleet_in, fleet_in_two
from tests.support.service_world import TENANT, memory_world


def cancelling(world, operation_id, seen):
    """A merger that finds its operation cancelled, by somebody else, while it compares surfaces."""

    class Merger(FakeMerger):
        def compare(self, first, second, read, scale, progress):
            job = world.context.transactions.read(lambda uow: uow.jobs.get(TENANT, operation_id)).result()
            seen.append(job.progress["stage"])
            world.context.transactions.write(
                lambda uow: world.use_cases.operations._cancel(uow, TENANT, operation_id)
            ).result()
            return super().compare(first, second, read, scale, progress)

    return Merger()


async def test_a_merge_that_is_cancelled_while_it_runs_changes_nothing():
    world, seen = memory_world(), []
    fleet_in_two(world, ("one", "two"), sessions=2, submaps=20, per_pair=0)
    posted = (await world.use_cases.map_merges.merge(TENANT, MergeMap("one", "two"))).operation
    world.merger = cancelling(world, posted.operation_id, seen)
    before = world.context.transactions.read(lambda uow: (uow.maps.find(TENANT), uow.sessions.find(TENANT))).result()
    world.work_off()
    ended = await world.use_cases.operations.get(TENANT, posted.operation_id)
    assert (ended.state, ended.result) == ("DONE", {"outcome": "the operation was cancelled"})
    assert seen == ["ALIGN"] and operation_fields(ended)["progress"] is None
    after = world.context.transactions.read(lambda uow: (uow.maps.find(TENANT), uow.sessions.find(TENANT))).result()
    assert after == before


async def test_an_optimisation_that_is_cancelled_once_it_is_claimed_ends_at_its_first_step():
    world = memory_world()
    made = fleet_in(world, "fleet", sessions=2, submaps=10, per_pair=5)
    posted = (await world.use_cases.map_versions.optimise(TENANT, made.map_id)).operation
    lease = world.claim()
    cancelled = await world.use_cases.operations.cancel(TENANT, posted.operation_id)
    assert (cancelled.state, cancelled.cancel_requested) == ("RUNNING", True)
    world.worker().run(lease)
    ended = await world.use_cases.operations.get(TENANT, posted.operation_id)
    assert (ended.state, ended.result) == ("DONE", {"outcome": "the operation was cancelled"})
    assert (await world.use_cases.maps.get(TENANT, made.map_id)).map_version == 0
