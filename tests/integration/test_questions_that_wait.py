"""Questions with long payloads wait for a worker, however many: each is queued once, and none is read for another."""

from __future__ import annotations

from revisit.service.domain.states import OperationKind
from tests.support.memory.repositories import MemoryRepository
from tests.support.service_world import TENANT, World, memory_world

SUBJECT = "maps/town/versions/1"


def asked(world: World, *points_m: float) -> tuple[str, bool]:
    """Ask about points; the id of the operation, and whether it was there already."""
    payload = {"map_id": "town", "points_m": list(points_m)}
    jobs = world.use_cases.map_tiles._context.jobs
    ask = world.context.transactions.write(
        lambda uow: jobs.ask(uow, TENANT, OperationKind.MEASURE_MAP, SUBJECT, payload)
    )
    job, joined = ask.result()
    return job.operation_id, joined


def ended(world: World) -> None:
    """Each question that waits is answered."""
    while (lease := world.claim()) is not None:
        world.context.transactions.write(lambda uow, lease=lease: uow.queue.complete(lease, {})).result()


def test_a_question_that_waits_is_joined_and_another_is_not():
    world = memory_world()
    first, second = asked(world, 1.0, 2.0), asked(world, 1.0, 2.5)
    assert (first[1], second[1]) == (False, False) and first[0] != second[0]
    assert asked(world, 1.0, 2.0) == (first[0], True)
    world.claim()
    assert asked(world, 1.0, 2.0) == (first[0], True), "it runs"


def test_a_question_that_was_answered_is_asked_again_and_its_answer_stays_for_a_minute():
    world = memory_world()
    first, _ = asked(world, 1.0)
    ended(world)
    again, joined = asked(world, 1.0)
    assert again != first and not joined
    ended(world)
    world.clock.ms += 61_000
    assert asked(world, 1.0) == (first, False)


def test_nothing_that_waits_is_read_for_another_question(monkeypatch):
    world = memory_world()
    for number in range(20):
        asked(world, float(number))

    def find(*_, **__):
        raise AssertionError("payloads of others are read")

    monkeypatch.setattr(MemoryRepository, "find", find)
    assert asked(world, 7.0)[1] and not asked(world, 77.0)[1]
