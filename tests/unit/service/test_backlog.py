"""The backlog: full with the jobs that wait and the clouds in flight, and counted seldom."""

from __future__ import annotations

import pytest

from revisit.service.capacity.backlog import Backlog
from revisit.service.capacity.in_flight import InFlight
from revisit.service.capacity.limits import CapacityLimits
from revisit.service.domain.errors import WorkersBusy
from tests.support.service_world import memory_world, open_session, submap


class Clock:
    """Seconds that pass when told to."""

    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


class Counting:
    """Storage that counts how often it is read."""

    def __init__(self, storage):
        self.storage, self.reads = storage, 0

    async def read(self, work):
        self.reads += 1
        return await self.storage.read(work)


@pytest.fixture
def world():
    return memory_world()


async def filled(world, jobs):
    await open_session(world)
    for number in range(jobs):
        await world.use_cases.posting.post("default", submap(f"s{number}", number))


def backlog_over(world, most, in_flight=None):
    clock, storage = Clock(), Counting(world.context.storage)
    return Backlog(storage, in_flight or InFlight(), most, clock), storage, clock


def post_a_job(world, backlog):
    world.context.transactions.read(lambda uow: backlog.require_space(uow, "default")).result()


async def test_clouds_in_flight_count_as_jobs_to_come(world):
    await filled(world, 3)
    in_flight = InFlight(CapacityLimits(clouds=4, tenant_share=1.0))
    backlog, _, _ = backlog_over(world, 4, in_flight)
    post_a_job(world, backlog)
    await backlog.precheck("default")
    async with in_flight.reserve_cloud("default"):
        with pytest.raises(WorkersBusy, match="4 jobs are waiting"):
            await backlog.precheck("default")
        await backlog.precheck("bert")
    await backlog.precheck("default")


async def test_a_full_backlog_is_counted_again_at_most_twenty_times_a_second(world):
    await filled(world, 2)
    backlog, storage, clock = backlog_over(world, 2)
    with pytest.raises(WorkersBusy):
        post_a_job(world, backlog)
    for _ in range(10):
        with pytest.raises(WorkersBusy):
            await backlog.precheck("default")
    assert storage.reads == 1
    world.work_off()
    clock.now_s += 0.051
    await backlog.precheck("default")
    assert storage.reads == 2
