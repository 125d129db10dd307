"""Workers at the same time: no loop is missed, no late result counts, nothing is done twice."""

from __future__ import annotations

import threading

import pytest

from revisit.service.domain.identity import SubmapKey
from revisit.service.domain.states import LoopState, OperationState, SubmapState
from revisit.service.features.resources.paging import PageRequest
from tests.support.fake_recogniser import FakeRecogniser
from tests.support.patience import PATIENCE_S
from tests.support.service_world import SESSION, TENANT, memory_world, open_session, posted, sqlite_world, submap


@pytest.fixture(params=["memory", "sqlite"])
def world(request, tmp_path):
    made = memory_world() if request.param == "memory" else sqlite_world(tmp_path)
    yield made
    made.context.transactions.close()


class Halting(FakeRecogniser):
    """Stops in `describe` until told to go on."""

    def __init__(self) -> None:
        self.arrived, self.go_on = threading.Event(), threading.Event()

    def describe(self, submap, config):
        self.arrived.set()
        assert self.go_on.wait(PATIENCE_S)
        return super().describe(submap, config)


async def accepted(world):
    page = await world.use_cases.loops.list(TENANT, "town", PageRequest(), state=LoopState.ACCEPTED)
    return [{loop.query.submap_id, loop.match.submap_id} for loop in page.items]


async def test_two_workers_that_describe_both_sides_of_a_loop_at_once_find_it_once(world):
    # b keeps a and c apart: neighbours are no candidates.
    await posted(world, a=1, b=2, c=1)
    barrier = threading.Barrier(2)

    class Together(FakeRecogniser):
        def describe(self, given, config):
            barrier.wait(PATIENCE_S)
            return super().describe(given, config)

    first, between, second = world.claim("w1"), world.claim("w2"), world.claim("w3")
    world.worker().run(between)
    threads = [threading.Thread(target=world.worker(Together()).run, args=(lease,)) for lease in (first, second)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE_S)
    assert await accepted(world) == [{"a", "c"}]


async def test_the_loop_is_found_when_the_match_enters_after_the_search(world):
    """The interleaving itself, forced: c has searched and verifies, a enters and is committed, c comes to commit."""
    await posted(world, old=9, a=1, b=12, c=1)
    lease_old, lease_a, _, lease_c = (world.claim(f"w{number}") for number in range(4))
    world.worker().run(lease_old)
    similarities = []

    class CommitsAMeanwhile(FakeRecogniser):
        def verify(self, query, match, similarity, config, initial=None):
            if not similarities:
                world.worker().run(lease_a)
            similarities.append(round(similarity, 3))
            return super().verify(query, match, similarity, config, initial)

    world.worker(CommitsAMeanwhile()).run(lease_c)
    assert await accepted(world) == [{"a", "c"}]
    # a, which entered later, has found c; c did not search again.
    assert similarities == [0.0]


async def test_a_worker_that_lost_its_lease_changes_nothing(world):
    await open_session(world)
    posted = await world.use_cases.posting.post(TENANT, submap("a", 1))
    slow = Halting()
    late = world.claim("slow")
    thread = threading.Thread(target=world.worker(slow).run, args=(late,))
    thread.start()
    assert slow.arrived.wait(PATIENCE_S)
    world.clock.ms += world.context.policy.lease_ms
    current = world.claim("quick")
    world.worker().run(current)
    before = await world.use_cases.operations.get(TENANT, posted.operation.operation_id)
    slow.go_on.set()
    thread.join(PATIENCE_S)
    after = await world.use_cases.operations.get(TENANT, posted.operation.operation_id)
    assert before == after and after.attempts == 2
    changes = world.context.transactions.read(lambda uow: uow.changes.since(TENANT, 1, 0)).result()
    assert len(changes) == 1


async def test_a_late_failure_does_not_undo_a_success(world):
    await open_session(world)
    posted = await world.use_cases.posting.post(TENANT, submap("a", 1))

    class Fails(FakeRecogniser):
        def describe(self, given, config):
            world.clock.ms += world.context.policy.lease_ms
            world.worker().run(world.claim("quick"))
            raise RuntimeError("too late")

    world.worker(Fails()).run(world.claim("slow"))
    operation = await world.use_cases.operations.get(TENANT, posted.operation.operation_id)
    view = await world.use_cases.submaps.get(TENANT, SubmapKey(SESSION.map_id, SESSION.session_id, "a"))
    assert (operation.state, view.state) == (OperationState.DONE, SubmapState.DESCRIBED)


async def test_a_submap_deleted_while_it_is_described_stays_deleted(world):
    await open_session(world)
    posted = await world.use_cases.posting.post(TENANT, submap("a", 1))
    slow = Halting()
    thread = threading.Thread(target=world.worker(slow).run, args=(world.claim(),))
    thread.start()
    assert slow.arrived.wait(PATIENCE_S)
    await world.use_cases.submaps.delete(TENANT, SubmapKey(SESSION.map_id, SESSION.session_id, "a"))
    slow.go_on.set()
    thread.join(PATIENCE_S)
    assert (await world.use_cases.operations.get(TENANT, posted.operation.operation_id)).done
    assert not (await world.use_cases.submaps.list(TENANT, SESSION, PageRequest())).items


async def test_a_match_deleted_during_verification_makes_no_loop(world):
    await posted(world, a=1, b=2, c=1)
    for _ in range(2):
        world.worker().run(world.claim())

    class DeletesTheMatch(FakeRecogniser):
        def verify(self, query, match, similarity, config, initial=None):
            def delete(uow):
                record = uow.submaps.get(TENANT, "town", "monday", "a")
                uow.submaps.delete(TENANT, number=record.number)
                uow.changes.record_removed(uow.maps.get(TENANT, "town"), [record.number])

            world.context.transactions.write(delete).result()
            return super().verify(query, match, similarity, config, initial)

    world.worker(DeletesTheMatch()).run(world.claim())
    assert await accepted(world) == []
    described = await world.use_cases.submaps.get(TENANT, SubmapKey("town", "monday", "c"))
    assert described.state == SubmapState.DESCRIBED
