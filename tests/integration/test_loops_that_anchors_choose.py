"""Two drives where places repeat: geometry finds poses a period apart, anchors choose among them. Simulated."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_matrix, pose_row
from revisit.core.pair_verdict import Authority, VerifiedLoop
from revisit.service.domain.identity import SessionKey
from revisit.service.features.recognition import beside_anchors
from tests.integration.test_recalled_loops import MAP, Geometry, Town
from tests.support.fleet_in_service import fleet_in
from tests.support.made_up_anchors import new_anchors, with_stamps
from tests.support.service_world import TENANT, memory_world

PERIOD_M = 6.0


class Lattice(Geometry):
    """Registers a pair where it is told to start: every pose fits."""

    def verify(self, query, match, similarity, config, initial=None):
        found = super().verify(query, match, similarity, config, initial)
        if initial is None or not isinstance(found, VerifiedLoop):
            return found
        return VerifiedLoop(replace(found.measurement, T_match_query=initial.T_match_query))


class RepeatingTown(Town):
    """All loops between the two drives are ambiguous, the true pose behind one that is a period off."""

    def __init__(self, world):
        super().__init__(world, store=self._stored)
        with_stamps(world)
        self.true = {loop.loop_id: loop for loop in self.right}
        for loop in self.right:
            self._made_ambiguous(loop)

    def _stored(self, world, map_id, **fields):
        self.made = fleet_in(world, map_id, 0.0, sessions=2, submaps=24, per_pair=16, **fields).fleet

    def _made_ambiguous(self, loop):
        T = pose_matrix(loop.T_match_query)
        first, other = (se3.from_yaw(0.0, (k * PERIOD_M, 0.0, 0.0)) @ T for k in (1, -1))
        measurement = {**loop.evidence.get("measurement", {}), "overlap": 0.7}
        measurement["rivals"] = [{"overlap": 0.7, "T_match_query": pose.tolist()} for pose in (T, other)]
        evidence = {**loop.evidence, "measurement": measurement}
        self.rejected(loop, reason="AMBIGUOUS", T_match_query=pose_row(first), evidence=evidence)

    async def anchored(self, sigma_m, shift_m=0.0, geometry=None):
        told = {name: new_anchors(self.made, name, sigma_m) for name in ("s0", "s1")}
        told["s1"] = [_further_east(one, shift_m) for one in told["s1"]]
        for name, anchors in told.items():
            await self.world.use_cases.anchors.post(TENANT, SessionKey(MAP, name), anchors)
        geometry = geometry or Lattice()
        await self.optimised(geometry)
        return geometry

    async def without_anchors(self, *sessions):
        for session in sessions:
            for one in self.read(lambda uow, its=session: uow.anchors.find(TENANT, map_id=MAP, session_id=its)):
                await self.world.use_cases.anchors.delete(TENANT, MAP, session, one.anchor_id)

    def changed(self, work):
        self.world.context.transactions.write(work).result()

    @property
    def accepted(self):
        return [one for one in self.loops() if one.state == "ACCEPTED"]

    @property
    def frames(self):
        return self.read(lambda uow: uow.map_versions.find(TENANT, map_id=MAP))[-1].summary["frames"]


def _further_east(anchor, shift_m):
    latitude, longitude, altitude = anchor.position
    east = math.degrees(shift_m / 6_371_000.0 / math.cos(math.radians(latitude)))
    return replace(anchor, position=(latitude, longitude + east, altitude))


@pytest.fixture
def town():
    made = RepeatingTown(memory_world(optimise_after_loops=1))
    yield made
    made.world.context.transactions.close()


async def test_anchors_of_centimetres_choose_the_true_poses_and_the_drives_join(town):
    geometry = await town.anchored(0.02)
    chosen = town.accepted
    assert len(chosen) >= 10 and town.frames == 1
    for loop in chosen:
        true = pose_matrix(town.true[loop.loop_id].T_match_query)
        assert np.linalg.norm((pose_matrix(loop.T_match_query) - true)[:3, 3]) < 1e-6
        assert loop.graph_state == "IN_MAP" and loop.evidence["support"]["on_earth"]
        assert "anchors beside both submaps agree with this one alone" in loop.evidence["support"]["words"]
    assert {one.authority for one in geometry.asked} == {Authority.DECIDES}
    last = [one for one in town.events(chosen[0]) if one.kind == "VERIFIED"][-1]
    assert "where anchors put the two submaps" in last.note


async def test_loops_are_ambiguous_again_once_the_anchors_are_gone_and_return_with_them(town):
    await town.anchored(0.02)
    chosen = {one.loop_id for one in town.accepted}
    await town.without_anchors("s1")
    await town.optimised(Lattice())
    assert town.accepted == [] and town.frames == 2
    lost = town.loop(next(one for one in town.right if one.loop_id in chosen))
    assert (lost.reason, [*lost.evidence["doubts"]]) == ("AMBIGUOUS", ["SUPPORT_LOST"])
    assert len(lost.evidence["measurement"]["rivals"]) == 2
    await town.anchored(0.02)
    assert {one.loop_id for one in town.accepted} == chosen


@pytest.mark.parametrize(
    ("sigma_m", "shift_m"), [(1.5, 0.0), (0.02, 3.0)], ids=["fixes of metres", "a base station 3 m off"]
)
async def test_anchors_that_err_by_half_a_period_choose_none(town, sigma_m, shift_m):
    geometry = await town.anchored(sigma_m, shift_m)
    assert town.accepted == [] and geometry.asked == [] and town.frames == 2


async def test_a_pair_that_does_not_pass_at_the_chosen_pose_stays_ambiguous(town):
    await town.anchored(0.02, geometry=Geometry(blind=True))
    assert town.accepted == [] and town.loop(town.right[0]).reason == "AMBIGUOUS"


async def test_loops_are_withdrawn_in_a_map_that_has_no_other_rejected_ones_and_keeps_few_versions():
    town = RepeatingTown(memory_world(optimise_after_loops=1, map_versions_kept=1))
    await town.anchored(0.02)
    chosen, others = town.accepted, [one for one in town.loops() if one.state == "REJECTED"]
    town.changed(lambda uow: [uow.loops.replace(replace(one, manual=True)) for one in others])
    await town.without_anchors("s0", "s1")
    await town.optimised(Lattice())
    assert len(chosen) >= 10 and town.accepted == []


async def test_a_loop_on_which_a_person_decided_stays_as_they_left_it(town):
    await town.anchored(0.02)
    dropped, back, *_ = town.accepted
    people = town.world.use_cases.loop_decisions
    await people.reject(TENANT, MAP, dropped.loop_id)
    await people.reject(TENANT, MAP, back.loop_id)
    await people.revert(TENANT, MAP, back.loop_id)
    await town.optimised(Lattice())
    assert (town.loop(dropped).state, town.loop(back).state) == ("REJECTED", "ACCEPTED")
    await town.without_anchors("s0", "s1")
    await town.optimised(Lattice())
    assert {one.loop_id for one in town.accepted} == {back.loop_id}


async def test_chosen_loops_are_withdrawn_once_loops_that_geometry_is_sure_of_contradict_the_anchors(town):
    await town.anchored(0.02)
    chosen = town.accepted
    T_aside = se3.from_yaw(0.0, (PERIOD_M, 0.0, 0.0))
    sure = [
        replace(
            one,
            T_match_query=pose_row(T_aside @ pose_matrix(one.T_match_query)),
            evidence={name: its for name, its in one.evidence.items() if name != "support"},
        )
        for one in chosen[:4]
    ]
    town.changed(lambda uow: [uow.loops.replace(one) for one in sure])
    await town.optimised(Lattice())
    assert {one.loop_id for one in town.accepted} == {one.loop_id for one in sure}


async def test_the_graph_of_a_map_without_anchors_is_not_read(town, monkeypatch):
    """Its loops are as many as before, and none is asked about."""
    read = []
    monkeypatch.setattr(beside_anchors, "read_task", lambda *_: read.append(1))
    await town.optimised(Lattice())
    assert town.accepted == [] and read == []


async def test_a_second_loop_of_a_submap_waits_until_the_others_have_one(town):
    first = town.loop(town.right[0])
    more = [replace(first, loop_id=f"more{n}", number=0, seq=0, similarity=0.99) for n in range(4)]
    town.changed(lambda uow: uow.loops.add_all(more))
    for name in ("s0", "s1"):
        await town.world.use_cases.anchors.post(TENANT, SessionKey(MAP, name), new_anchors(town.made, name, 0.02))
    context = town.world.context
    found = beside_anchors.loops_by_anchors(context.transactions, context.policy, TENANT, MAP, lambda *_: False).chosen
    loops = town.read(lambda uow: uow.loops.numbered(TENANT, [one.number for one in found]))
    queries = [loops[one.number].query_number for one in found]
    several = len({*queries})
    assert len(found) > several > 5 and len({*queries[:several]}) == several
