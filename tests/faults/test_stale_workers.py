"""A worker that wakes up after its lease ran out and another did its job: its result is refused (P15)."""

from __future__ import annotations

import asyncio

import pytest
import structlog

from tests.faults.survey import survey
from tests.support.campaigns import Campaign, sizes
from tests.support.fake_recogniser import NOWHERE, MistakenRecogniser
from tests.support.service_world import SESSION, TENANT, World, open_session, sqlite_world, submap

PLACES = 7


class Overslept(MistakenRecogniser):
    """While it describes, its lease runs out and a quicker worker does the job; what it says is not what that said."""

    def __init__(self, world: World) -> None:
        self.overtaken = 0
        self._world = world

    def describe(self, submap, config):
        self._world.clock.ms += self._world.context.policy.lease_ms
        current = self._world.claim("quick")
        assert current is not None, "the lease did not run out"
        self._world.worker().run(current)
        self.overtaken += 1
        return super().describe(submap, config)


@pytest.fixture
def world(folder):
    made = sqlite_world(folder / "home", max_queued_jobs=1_000_000)
    asyncio.run(open_session(made))
    yield made
    made.context.transactions.close()


@pytest.mark.parametrize("jobs", sizes("STALE_WORKERS", 8, 500))
@pytest.mark.timeout(3600)
def test_the_late_result_of_a_worker_that_lost_its_lease_is_refused(world, folder, jobs):
    slow = Overslept(world)
    late = world.worker(slow)
    campaign = Campaign("P15", jobs)
    for number in campaign:
        # Places are seen again, so that both runs find loops.
        asyncio.run(world.use_cases.posting.post(TENANT, submap(f"s{number}", number % PLACES, SESSION)))
        with structlog.testing.capture_logs() as logged:
            late.run(world.claim("slow"))
        assert [entry["event"] for entry in logged] == ["result_refused"]
    stored = world.context.transactions.read(lambda uow: (uow.submaps.find(TENANT), uow.jobs.find(TENANT))).result()
    assert slow.overtaken == campaign.done
    assert NOWHERE.tobytes() not in {record.descriptor for record in stored[0]}
    assert {(job.state, job.attempts, job.lease_owner) for job in stored[1]} == {("DONE", 2, "quick")}
    found = survey(folder / "home")
    assert found.problems == [] and found.states == {"DESCRIBED": campaign.done}
    campaign.publish(f"{campaign.done} of {campaign.done} late results refused, 0 with effect")
