"""What a worker holds while it optimises a map: no evidence, no older solution, of a large map no prepared places."""

from __future__ import annotations

import pytest

from revisit.service.adapters.core_map_optimiser import CoreMapOptimiser
from revisit.service.domain.policy import Policy
from revisit.service.domain.states import LoopEventKind
from revisit.service.features.corrections.job import EarlyCorrections
from revisit.service.features.graph import reading as graph_reading
from revisit.service.features.graph.reading import read_task, with_evidence
from revisit.service.features.loops.rows import Change, add_loop
from revisit.service.features.optimisation import job as optimisation
from tests.support.fake_recogniser import FakeRecogniser
from tests.support.fleet_in_service import fleet_in, loop_record
from tests.support.service_world import TENANT, memory_world


class Counting(CoreMapOptimiser):
    """Counts the maps that it solves for early corrections."""

    def __init__(self):
        self.solutions = 0

    def solved(self, graph, tracks):
        self.solutions += 1
        return super().solved(graph, tracks)


class Keeping(FakeRecogniser):
    """Counts how often it is asked to let go."""

    released = 0

    def release(self):
        self.released += 1


@pytest.fixture
def world():
    world = memory_world()
    world.fleet = fleet_in(world, "town", sessions=2, submaps=12, per_pair=20)
    return world


def read(world, work):
    return world.context.transactions.read(work).result()


@pytest.mark.parametrize("page", [1, 3, 500])
def test_a_graph_is_read_page_by_page_without_evidence_that_can_be_read_again(world, monkeypatch, page):
    stored = [one for one in read(world, lambda uow: uow.loops.find(TENANT, state="ACCEPTED")) if one.T_match_query]
    monkeypatch.setattr(graph_reading, "_PAGE", page)
    task = read(world, lambda uow: read_task(uow, Policy(), TENANT, "town"))
    assert len(stored) > 3 and any(one.evidence for one in stored)
    assert [one.number for one in task.loops] == [one.number for one in stored] == [o.number for o in task.graph.loops]
    assert not any(one.evidence for one in task.loops)
    assert read(world, lambda uow: list(with_evidence(uow, task.loops))) == stored


@pytest.mark.parametrize(("large", "times"), [(1, 1), (10_000, 0)])
async def test_room_is_made_before_a_large_map_is_optimised(world, monkeypatch, large, times):
    monkeypatch.setattr(optimisation, "LARGE_MAP_LOOPS", large)
    recogniser = Keeping()
    await world.use_cases.map_versions.optimise(TENANT, "town")
    assert world.work_off(recogniser) == 1
    assert recogniser.released == times


async def test_a_map_that_was_let_go_of_is_solved_again_and_another_one_is_not(world):
    loops = world.fleet.fleet.graph.loops
    submaps = {(one.session_id, one.ordinal): one for one in read(world, lambda uow: uow.submaps.find(TENANT))}
    removed = loops[:3]
    write = world.context.transactions.write
    for loop in removed:
        write(lambda uow, loop=loop: uow.loops.delete(TENANT, loop_id=loop.name)).result()
    await world.use_cases.map_versions.optimise(TENANT, "town")
    assert world.work_off() == 1
    optimiser = Counting()
    early = EarlyCorrections(world.context.transactions, world.clock, Policy(optimise_after_loops=1), optimiser)
    counts = []
    for loop, released in zip(removed, ("village", "town", "town"), strict=True):
        record = loop_record(loop, submaps)
        write(lambda uow, record=record: add_loop(uow, record, Change(LoopEventKind.VERIFIED, 1))).result()
        early.update(TENANT, "town")
        early.release(TENANT, released)
        counts.append(optimiser.solutions)
    assert counts == [1, 1, 2]
