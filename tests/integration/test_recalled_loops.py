"""Rejected loops are tested again from where a new version of their map has their submaps. A made-up fleet."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_matrix, pose_row
from revisit.core.verification import Authority, InitialPose, VerifiedLoop
from revisit.service.engines.sql.loops import SqlLoops
from revisit.service.failpoints import arm
from revisit.service.features.graph.map_frames import LoopInMap, MapPose
from revisit.service.features.loops.rows import LoopStanding
from revisit.service.features.recognition import beside_faults, loop_recall_job
from revisit.service.features.recognition.loop_recall_job import loops_to_recall
from revisit.service.ports.repositories import LoopEnds
from tests.support.fake_recogniser import FakeRecogniser
from tests.support.fleet_in_service import fleet_in, slipped_fleet_in
from tests.support.service_world import TENANT, memory_world, sqlite_world
from tests.support.verdicts import rejected

MAP = "town"


class Geometry(FakeRecogniser):
    """Finds the right pose only where it is told where to start; what it was asked is kept."""

    def __init__(self, aside_m: float = 0.0, blind: bool = False) -> None:
        self.asked: list[InitialPose] = []
        self._aside_m, self._blind = aside_m, blind

    def verify(self, query, match, similarity, config, initial=None):
        if initial is None or initial.authority is Authority.HINT:
            return rejected()
        self.asked.append(initial)
        found = super().verify(query, match, similarity, config, initial)
        if self._blind or not isinstance(found, VerifiedLoop):
            return rejected("LOW_OVERLAP", initial.T_match_query)
        T = found.measurement.T_match_query.copy()
        T[0, 3] += self._aside_m
        return VerifiedLoop(replace(found.measurement, T_match_query=T))


class Town:
    """A map of two drives of which some right loops were rejected, in a service that optimises maps by itself."""

    def __init__(self, world, store=None) -> None:
        self.world = world
        if store is None:
            fleet_in(world, MAP, 0.3, sessions=2, submaps=16, per_pair=12, with_places=True)
        else:
            store(world, MAP, with_places=True)
        self.right = [loop for loop in self.loops() if loop.loop_id.startswith("right")]

    def loops(self):
        return self.read(lambda uow: uow.loops.find(TENANT, map_id=MAP))

    def loop(self, known):
        return self.read(lambda uow: uow.loops.get(TENANT, MAP, known.loop_id))

    def events(self, known):
        return self.read(lambda uow: uow.loop_events.find(TENANT, map_id=MAP, loop_id=known.loop_id))

    def read(self, work):
        return self.world.context.transactions.read(work).result()

    def rejected(self, *loops, reason="LOW_OVERLAP", **fields):
        """These loops as if geometry had rejected them, when their submaps were described."""
        fields = {"state": "REJECTED", "reason": reason, "score": 0.1, **fields}

        def work(uow) -> None:
            for loop in loops:
                event = uow.loop_events.find(TENANT, map_id=MAP, loop_id=loop.loop_id)[0]
                uow.loops.replace(replace(loop, **fields))
                uow.loop_events.replace(replace(event, state="REJECTED", reason=reason))

        self.world.context.transactions.write(work).result()

    async def optimised(self, geometry) -> int:
        """How many jobs ran: a version of the map, and all that follows from it."""
        await self.world.use_cases.map_versions.optimise(TENANT, MAP)
        done = 0
        while (now := self.world.work_off(geometry)) > 0:
            done += now
            self.world.clock.ms += 60_000
        return done


@pytest.fixture
def town():
    return Town(memory_world(optimise_after_loops=1))


@pytest.fixture(params=["memory", "sqlite"])
def kept_town(request, tmp_path):
    rules = {"optimise_after_loops": 1}
    world = memory_world(**rules) if request.param == "memory" else sqlite_world(tmp_path, **rules)
    yield Town(world)
    world.context.transactions.close()


async def test_a_rejected_loop_returns_once_the_map_says_where_to_look(kept_town):
    town = kept_town
    lost, geometry = town.right[0], Geometry()
    town.rejected(lost)
    assert await town.optimised(geometry) == 3  # a version, recall, and a version with the loop
    loop, events = town.loop(lost), town.events(lost)
    assert (loop.state, loop.reason, loop.graph_state) == ("ACCEPTED", None, "IN_MAP")
    assert all(LoopStanding.of(town.events(one)[-1]) == LoopStanding.of(one) for one in town.loops())
    assert [event.kind for event in events] == ["VERIFIED", "VERIFIED", "JUDGED"]
    assert (events[1].actor, events[1].map_version) == ("map version 1", 1)
    assert "LOW_OVERLAP" in events[1].note
    assert events[1].details["model_version"] == "fake-1"
    assert events[1].details["thresholds"] == loop.evidence["thresholds"]
    # The map's pose is where registration starts, and no more: what else fits counts against it.
    assert [one.authority for one in geometry.asked] == [Authority.COMPETES]
    assert loop.evidence["recall"]["before"] == "LOW_OVERLAP" and loop.evidence["recall"]["map_version"] == 1


async def test_what_is_rejected_again_is_not_tested_from_there_a_third_time(town):
    lost, geometry = town.right[0], Geometry(blind=True)
    town.rejected(lost)
    assert await town.optimised(geometry) == 2
    loop = town.loop(lost)
    assert (loop.state, loop.reason, loop.score, loop.T_match_query) == (
        "REJECTED", "LOW_OVERLAP", 0.1, lost.T_match_query)  # fmt: skip
    assert [event.state for event in town.events(lost)] == ["REJECTED", "REJECTED"]
    await town.optimised(geometry)
    assert len(geometry.asked) == 1


async def test_each_version_tests_a_bounded_number_and_the_next_goes_on(town, monkeypatch):
    monkeypatch.setattr(loop_recall_job, "MOST_RECALLED", 1)
    first, second = town.right[:2]
    town.rejected(first, similarity=0.6)
    town.rejected(second, similarity=0.7)
    geometry = Geometry(blind=True)
    await town.optimised(geometry)
    assert ["recall" in town.loop(one).evidence for one in (first, second)] == [False, True]
    await town.optimised(geometry)
    assert ["recall" in town.loop(one).evidence for one in (first, second)] == [True, True]


async def test_wrong_pairs_ambiguous_ones_and_what_people_decided_are_left_alone(town):
    ambiguous, by_hand, decided, *_ = town.right
    wrong = [loop for loop in town.loops() if not loop.loop_id.startswith("right")]
    town.rejected(*wrong)
    town.rejected(ambiguous, reason="AMBIGUOUS")
    town.rejected(by_hand, manual=True)
    town.rejected(decided)
    await town.world.use_cases.loop_decisions.accept(TENANT, MAP, decided.loop_id)
    await town.world.use_cases.loop_decisions.revert(TENANT, MAP, decided.loop_id)
    geometry = Geometry()
    await town.optimised(geometry)
    assert wrong and [town.loop(one).state for one in (ambiguous, by_hand, decided)] == ["REJECTED"] * 3
    # Of the wrong pairs those may be asked that happen to lie near each other; the pose is then the right one.
    assert len(geometry.asked) < len(wrong)


async def test_whole_rows_are_read_of_those_rejected_loops_alone_that_the_map_puts_near(tmp_path, monkeypatch):
    town, read = Town(sqlite_world(tmp_path, optimise_after_loops=0)), Counter()
    wrong = [loop for loop in town.loops() if not loop.loop_id.startswith("right")]
    lost = town.right[:2]
    town.rejected(*wrong, *lost)
    await town.optimised(Geometry())
    whole = SqlLoops._of

    def counted(self, row):
        read["rows"] += 1
        return whole(self, row)

    monkeypatch.setattr(SqlLoops, "_of", counted)
    context = town.world.context
    found = loops_to_recall(context.transactions, context.policy, TENANT, MAP, lambda *_: None)
    context.transactions.close()
    assert {loop.loop_id for loop in lost} <= {one.record.loop_id for one in found}
    assert read["rows"] == len(found) < len(wrong)


async def test_a_pose_far_from_what_the_map_says_is_not_accepted(town):
    lost, geometry = town.right[0], Geometry(aside_m=4.0)
    town.rejected(lost)
    await town.optimised(geometry)
    assert len(geometry.asked) == 1
    assert town.loop(lost).state == "REJECTED" and town.loop(lost).evidence["recall"]["reason"] == "FAR_FROM_MAP"


async def test_a_result_that_comes_late_changes_nothing(town):
    lost, worker = town.right[0], town.world.worker(Geometry())
    town.rejected(lost)
    await town.world.use_cases.map_versions.optimise(TENANT, MAP)
    worker.run(town.world.claim())
    lease = town.world.claim()
    assert (lease.job.kind, lease.job.priority) == ("RECALL_LOOPS", 2)
    worker.run(lease)
    known = town.events(lost)
    assert len(known) == 2
    worker.run(lease)
    assert town.events(lost) == known


async def test_recall_that_breaks_off_is_done_again_and_changes_a_loop_once(town):
    lost = town.right[0]
    town.rejected(lost)
    arm("recall.before_commit=raise@1")
    try:
        await town.optimised(Geometry())
    finally:
        arm("")
    assert town.loop(lost).state == "ACCEPTED"
    assert [event.actor for event in town.events(lost)] == ["service", "map version 1", "service"]


async def test_a_map_that_is_only_optimised_when_asked_is_left_as_it_is():
    town, geometry = Town(memory_world()), Geometry()
    town.rejected(town.right[0])
    assert await town.optimised(geometry) == 1
    assert not geometry.asked


SLIP, BESIDE = 30, range(26, 34)
"""The submap of `s1` behind a slip of 5 m, and those beside it whose right loops contradict each other."""


def of_slipped(town: Town, loops, ordinals) -> list:
    """The loops with an end at these submaps of the session that slipped."""
    submaps = town.read(lambda uow: uow.submaps.find(TENANT, map_id=MAP, session_id="s1"))
    numbers = {one.number for one in submaps if one.ordinal in ordinals}
    return [loop for loop in loops if numbers & {loop.query_number, loop.match_number}]


def doubted(loops, *names: str) -> list:
    """The loops as acceptance leaves those that others contradict."""
    doubts = {name: {"words": "others say otherwise", "figures": {}} for name in names}
    return [replace(loop, evidence={**loop.evidence, "doubts": doubts}) for loop in loops]


async def test_loops_that_contradicted_each_other_across_a_slip_return_once_a_version_has_mended_it():
    town, geometry = Town(memory_world(optimise_after_loops=1), slipped_fleet_in), Geometry()
    beside = of_slipped(town, town.right, BESIDE)
    by_others, alias = (
        doubted(beside[1:], "PAIRWISE_INCONSISTENT", "SUPPORT_LOST"),
        doubted(beside[:1], "PERCEPTUAL_ALIAS"),
    )
    town.rejected(*by_others, *alias, reason="AMBIGUOUS", graph_state=None)
    await town.optimised(geometry)
    assert len(by_others) > 5
    assert {(town.loop(one).state, town.loop(one).graph_state) for one in by_others} == {("ACCEPTED", "IN_MAP")}
    assert not any("doubts" in town.loop(one).evidence for one in by_others)
    assert town.loop(alias[0]).state == "REJECTED"
    versions = town.read(lambda uow: uow.map_versions.find(TENANT, map_id=MAP))
    wide, narrow = (one.summary["odometry_faults"][0] for one in (versions[0], versions[-1]))
    assert wide["submaps"] > 6 and narrow["submaps"] <= 4
    ends = town.read(lambda uow: uow.submaps.numbered(TENANT, [narrow["first_number"], narrow["last_number"]]))
    assert ends[narrow["first_number"]].ordinal < SLIP <= ends[narrow["last_number"]].ordinal


async def test_the_mended_steps_of_a_version_are_read_once_for_all_pages_of_its_loops(monkeypatch):
    town, geometry, versions = Town(memory_world(optimise_after_loops=1), slipped_fleet_in), Geometry(), []
    town.rejected(*doubted(of_slipped(town, town.right, BESIDE), "SUPPORT_LOST"), reason="AMBIGUOUS", graph_state=None)
    read = beside_faults._sides

    def counted(uow, record, frames):
        versions.append(record.map_version)
        return read(uow, record, frames)

    monkeypatch.setattr(beside_faults, "_sides", counted)
    monkeypatch.setattr(beside_faults, "LOOPS_AT_ONCE", 2)
    await town.optimised(geometry)
    assert len(geometry.asked) > 5 and versions == sorted(set(versions))


async def test_a_contradicted_loop_that_agrees_with_no_side_of_a_slip_stays_ambiguous():
    town, geometry = Town(memory_world(optimise_after_loops=1), slipped_fleet_in), Geometry()
    wrong = []
    for loop in doubted(of_slipped(town, town.right, BESIDE), "PAIRWISE_INCONSISTENT"):
        T = list(loop.T_match_query)
        T[7] += 2.5  # aside
        wrong.append(replace(loop, T_match_query=tuple(T)))
    town.rejected(*wrong, reason="AMBIGUOUS", graph_state=None)
    await town.optimised(geometry)
    assert not geometry.asked
    assert {town.loop(one).state for one in wrong} == {"REJECTED"}


async def test_a_loop_before_a_slip_that_agrees_with_the_odometry_behind_it_alone_stays_ambiguous():
    """As places do that repeat each other at the length of the slip."""
    town, geometry = Town(memory_world(optimise_after_loops=1), slipped_fleet_in), Geometry()
    submaps = town.read(lambda uow: uow.submaps.find(TENANT, map_id=MAP, session_id="s1"))
    T_odom = {one.number: pose_matrix(one.T_odom_submap) for one in submaps}
    at_slip = next(pose_matrix(one.T_odom_submap) for one in submaps if one.ordinal == SLIP - 1)
    behind = at_slip @ se3.from_yaw(0.0, (5.0, 0.0, 0.0)) @ se3.inverse(at_slip)
    wrong = []
    for loop in doubted(of_slipped(town, town.right, [SLIP - 4]), "PAIRWISE_INCONSISTENT"):
        T, query, match = pose_matrix(loop.T_match_query), T_odom.get(loop.query_number), T_odom.get(loop.match_number)
        if query is not None and match is None:
            T = T @ se3.inverse(query) @ behind @ query
            wrong.append(replace(loop, T_match_query=pose_row(T)))
    town.rejected(*wrong, reason="AMBIGUOUS", graph_state=None)
    await town.optimised(geometry)
    assert wrong and not geometry.asked


def test_a_page_of_recall_asks_for_no_more_rows_than_a_read_may(monkeypatch):
    asked = []

    class Frames:
        def __init__(self, *_) -> None: ...

        def loops(self, records):
            asked.append(len({number for one in records for number in (one.query_number, one.match_number)}))
            here = MapPose(pose_row(np.eye(4)), "0", 1)
            return {one.number: LoopInMap(here, here) for one in records}

    class Loops:
        def rejected(self, *_, after, limit):
            return [LoopEnds(n, 2 * n, "s", 2 * n + 1, "s") for n in range(after + 1, after + 1 + limit)]

        def numbered(self, _, numbers):
            asked.append(len(numbers))
            return {}

    world = memory_world()
    record = SimpleNamespace(get=lambda *_: SimpleNamespace(map_version=1))
    monkeypatch.setattr(loop_recall_job, "MapFrames", Frames)
    monkeypatch.setattr(type(world.context.policy), "for_map", lambda *_: PipelineConfig())
    loop_recall_job._page(SimpleNamespace(maps=record, loops=Loops()), world.context.policy, TENANT, MAP, 0)
    assert len(asked) == 2 and max(asked) <= 1000
