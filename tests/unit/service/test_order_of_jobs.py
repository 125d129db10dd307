"""The order in which the jobs of a tenant run, whatever the order in which they are asked for."""

from __future__ import annotations

from functools import partial

from revisit.service.capacity.backlog import Backlog, JobPosting
from revisit.service.capacity.in_flight import InFlight
from revisit.service.domain.states import OperationKind
from tests.support.service_world import TENANT, memory_world, open_session, submap


async def test_a_submap_is_described_before_drives_are_compared_that_somebody_asks_about():
    world = memory_world()
    await open_session(world)
    backlog = Backlog(world.context.storage, InFlight(), 100)
    posting = JobPosting(backlog, world.clock, world.context.policy)
    for version in range(1, 4):
        its = {"map_id": "town", "version": version}
        post = partial(posting.post, tenant=TENANT, kind=OperationKind.FIND_CHANGES, subject="maps/town", payload=its)
        world.context.transactions.write(post).result()
    await world.use_cases.posting.post(TENANT, submap("a", 1))
    assert world.claim().job.kind == OperationKind.DESCRIBE_SUBMAP
    assert world.claim().job.kind == OperationKind.FIND_CHANGES
