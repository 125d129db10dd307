"""Loops that came after the last version of a map move its sessions at once, provisionally. A made-up fleet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import structlog

from revisit.core.pose_graph.graph import Node
from revisit.service.adapters.core_map_optimiser import CoreMapOptimiser
from revisit.service.domain.identity import SessionKey
from revisit.service.domain.policy import Policy
from revisit.service.domain.states import LoopEventKind
from revisit.service.features.corrections.job import MOST_AT_ONCE, EarlyCorrections
from revisit.service.features.loops.rows import Change, add_loop
from tests.support.fleet_in_service import fleet_in, loop_record
from tests.support.made_up_fleet import random_motion
from tests.support.records import a_job
from tests.support.service_world import TENANT, memory_world

LATE = 8
"""Submaps of the last session that come after the version, and their loops."""


class LateWorld:
    """A map with a version; then the last submaps of one of its sessions come in, and loops with them."""

    def __init__(self) -> None:
        self.world = memory_world()
        self.made = fleet_in(self.world, "town", sessions=2, submaps=30, per_pair=40)
        self.known = {Node("s0", n) for n in range(30)} | {Node("s1", n) for n in range(30 - LATE)}
        self.submaps = {
            (one.session_id, one.ordinal): one for one in self.read(lambda uow: uow.submaps.find(TENANT, map_id="town"))
        }
        self.late = [one for one in self.made.fleet.graph.loops if not {one.match, one.query} <= self.known]
        self.write(self._take_away)
        policy = Policy(optimise_after_loops=1)
        transactions, clock = self.world.context.transactions, self.world.clock
        self.early = EarlyCorrections(transactions, clock, policy, CoreMapOptimiser())

    def read(self, work):
        return self.world.context.transactions.read(work).result()

    def write(self, work):
        return self.world.context.transactions.write(work).result()

    def _take_away(self, uow) -> None:
        for loop in self.late:
            uow.loop_events.delete(TENANT, loop_id=loop.name)
            uow.loops.delete(TENANT, loop_id=loop.name)
        for ordinal in range(30 - LATE, 30):
            uow.submaps.delete(TENANT, number=self.submaps["s1", ordinal].number)

    def bring_back(self, loops) -> None:
        """The late submaps, and these loops."""

        def work(uow) -> None:
            for ordinal in range(30 - LATE, 30):
                self.submaps["s1", ordinal] = uow.submaps.add(replace(self.submaps["s1", ordinal], number=0))
            for loop in loops:
                add_loop(uow, loop_record(loop, self.submaps), Change(LoopEventKind.VERIFIED, 1))

        self.write(work)

    async def optimise(self) -> None:
        await self.world.use_cases.map_versions.optimise(TENANT, "town")
        assert self.world.work_off() == 1

    async def correction(self, session="s1"):
        return await self.world.use_cases.corrections.get(TENANT, SessionKey("town", session))


@pytest.fixture
async def late():
    made = LateWorld()
    await made.optimise()
    return made


async def test_a_loop_corrects_its_session_before_the_map_is_optimised_again(late):
    before = await late.correction()
    assert (before.map_version, before.early_loops) == (1, 0)
    late.bring_back(late.late)
    late.early.update(TENANT, "town")
    early = await late.correction()
    assert (early.map_version, early.early_loops) == (1, MOST_AT_ONCE) and len(late.late) > MOST_AT_ONCE
    await late.optimise()
    after = await late.correction()
    assert (after.map_version, after.early_loops) == (2, 0)
    T_odom_last = late.made.fleet.graph.by_session["s1"].T_odom_submap[-1]
    last = [(one.T_map_odom @ T_odom_last)[:3, 3] for one in (before, early, after)]
    assert np.linalg.norm(last[0] - last[2]) > 0.5
    assert np.linalg.norm(last[1] - last[2]) < 0.1


async def test_loops_one_after_the_other_are_asked_once_each_and_one_that_contradicts_the_map_moves_nothing(late):
    late.bring_back(late.late[:2])
    late.early.update(TENANT, "town")
    two = await late.correction()
    wrong = replace(late.late[2], T_match_query=random_motion(np.random.default_rng(0)))
    late.write(lambda uow: add_loop(uow, loop_record(wrong, late.submaps), Change(LoopEventKind.VERIFIED, 1)))
    late.early.update(TENANT, "town")
    same = await late.correction()
    assert (two.early_loops, same.early_loops) == (2, 2)
    np.testing.assert_array_equal(two.T_map_odom, same.T_map_odom)


async def test_a_decision_on_a_loop_forgets_what_was_corrected_ahead(late):
    version = await late.correction()
    late.bring_back(late.late)
    late.early.update(TENANT, "town")
    assert (await late.correction()).early_loops > 0
    await late.world.use_cases.loop_decisions.reject(TENANT, "town", late.late[0].name)
    again = await late.correction()
    assert again.early_loops == 0
    np.testing.assert_array_equal(again.T_map_odom, version.T_map_odom)
    late.early.update(TENANT, "town")
    assert (await late.correction()).early_loops == MOST_AT_ONCE


async def test_a_watch_tells_of_an_early_correction_and_of_the_version_that_replaces_it(late):
    corrections = late.world.use_cases.corrections.watch(TENANT, "town", session_id="s1")
    told = [await anext(corrections)]
    late.bring_back(late.late)
    late.early.update(TENANT, "town")
    told.append(await anext(corrections))
    await late.optimise()
    told.append(await anext(corrections))
    await corrections.aclose()
    assert [(one.map_version, one.early_loops) for one in told] == [(1, 0), (1, MOST_AT_ONCE), (2, 0)]


class SlowOptimiser(CoreMapOptimiser):
    """One that takes 400 ms to solve a map."""

    def __init__(self, clock) -> None:
        self._clock = clock

    def solved(self, graph, tracks):
        """See `MapOptimiser`."""
        self._clock.ms += 400
        return super().solved(graph, tracks)


def backlog(late, jobs: int) -> None:
    for number in range(jobs):
        late.write(lambda uow, name=f"op-{number}": uow.queue.enqueue(a_job(name, tenant=TENANT)))


async def test_loops_correct_their_session_though_many_jobs_wait(late):
    late.bring_back(late.late)
    backlog(late, 100)
    late.early.update(TENANT, "town")
    assert (await late.correction()).early_loops == MOST_AT_ONCE


async def test_corrections_take_a_fifth_of_a_workers_time_while_jobs_wait_and_what_came_meanwhile_is_asked_later(late):
    transactions, clock = late.world.context.transactions, late.world.clock
    early = EarlyCorrections(transactions, clock, Policy(optimise_after_loops=1), SlowOptimiser(clock))
    late.bring_back(late.late[:1])
    backlog(late, 1)
    early.update(TENANT, "town")
    assert (await late.correction()).early_loops == 1
    more = late.late[1]
    late.write(lambda uow: add_loop(uow, loop_record(more, late.submaps), Change(LoopEventKind.VERIFIED, 1)))
    clock.ms += 1599
    early.update(TENANT, "town")
    assert (await late.correction()).early_loops == 1
    clock.ms += 1
    early.update(TENANT, "town")
    assert (await late.correction()).early_loops == 2


async def test_a_worker_for_whom_nothing_but_the_next_version_waits_corrects_at_once(late):
    transactions, clock = late.world.context.transactions, late.world.clock
    early = EarlyCorrections(transactions, clock, Policy(optimise_after_loops=1), SlowOptimiser(clock))
    late.bring_back(late.late[:1])
    await late.world.use_cases.map_versions.optimise(TENANT, "town")
    early.update(TENANT, "town")
    more = late.late[1]
    late.write(lambda uow: add_loop(uow, loop_record(more, late.submaps), Change(LoopEventKind.VERIFIED, 1)))
    early.update(TENANT, "town")
    assert (await late.correction()).early_loops == 2


async def test_what_fails_ahead_of_a_version_harms_nobody(late, monkeypatch):
    late.bring_back(late.late)
    monkeypatch.setattr(CoreMapOptimiser, "solved", lambda *_: 1 / 0)
    with structlog.testing.capture_logs() as logged:
        late.early.update(TENANT, "town")
    assert [line["event"] for line in logged] == ["early_correction_failed"]
    assert (await late.correction()).early_loops == 0


def test_a_map_that_is_not_optimised_by_itself_is_not_corrected_by_itself():
    world = memory_world()
    fleet_in(world, "town", sessions=2, submaps=10, per_pair=4)
    early = EarlyCorrections(world.context.transactions, world.clock, Policy(), CoreMapOptimiser())
    early.update(TENANT, "town")
    assert world.context.transactions.read(lambda uow: uow.early_corrections.count(TENANT)).result() == 0
