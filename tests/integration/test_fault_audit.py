"""Faults of odometry that loops of one place show on a side: the surfaces decide. Made-up fleets and surfaces."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_row
from revisit.core.merge.evidence import MergeEvidence
from revisit.service.domain.identity import SessionKey
from revisit.service.features.graph.join_audit import FAULT_PAIRS
from revisit.service.features.resources.paging import PageRequest
from tests.support.fake_merger import FakeMerger
from tests.support.fleet_in_service import (
    fleet_in,
    lengthened_fleet_in,
    lifted_fleet_in,
    restarted_fleet_in,
    slipped_fleet_in,
)
from tests.support.service_world import TENANT, memory_world

MISPLACED = 45
"""The submap of `s1` from which on it is taken for another place; one place."""

HEARD = {*range(8, 27), *range(34, 53)}
"""The submaps of `s1` with loops, which has slipped by 5 m before its submap 30: 19 on either side, one place."""

NEAR_M = 10.0
"""Submaps farther apart have no surface in common."""


class Surfaces(FakeMerger):
    """Surfaces that agree where submaps lie to each other as in a `truth` (4, 4) each, by number, but for `within_m`;
    all do without one.
    """

    def __init__(self, truth: dict[int, np.ndarray] | None, within_m: float = 1.5) -> None:
        self._truth, self._within_m = truth, within_m

    def audit(self, first, second, surfaces, scale, most, progress) -> MergeEvidence:
        """Nothing is read."""
        off_m = [] if self._truth is None else [self._off_m(one, pose, second) for one, pose in first.items()]
        return MergeEvidence(5_000, 0.02, 0.01, 0.2 if max(off_m, default=0.0) > self._within_m else 0.001)

    def _off_m(self, one, pose, second) -> float:
        there = {n: se3.inverse(self._truth[n]) @ self._truth[one] for n in second}
        other = min(second, key=lambda n: np.linalg.norm(there[n][:3, 3]))
        found = se3.inverse(second[other]) @ pose
        near = np.linalg.norm(there[other][:3, 3]) < NEAR_M
        return float(np.linalg.norm((found - there[other])[:3, 3])) if near else 0.0


class Either(FakeMerger):
    """Surfaces that agree where they do by one of several."""

    def __init__(self, *several: Surfaces) -> None:
        self._several = several

    def audit(self, *asked) -> MergeEvidence:
        """Nothing is read."""
        return min((one.audit(*asked) for one in self._several), key=lambda found: found.seen_through_share)


class Contrary(FakeMerger):
    """Surfaces that agree nowhere."""

    def audit(self, first, second, surfaces, scale, most, progress) -> MergeEvidence:
        """Nothing is read."""
        return MergeEvidence(5_000, 0.02, 0.01, 0.2)


class Drives:
    """Drives of which one has slipped, or is taken for one beside it at its end; loops show one place there."""

    def __init__(self, *, slipped: bool, aside_m: float = 14.0, made: Callable | None = None) -> None:
        self.world, self.aside = memory_world(), se3.from_yaw(0.0, (0.0, aside_m, 0.0))
        sound = partial(fleet_in, sessions=2, submaps=60, per_pair=90)
        self.fleet = (made or (slipped_fleet_in if slipped else sound))(self.world, "town")
        self.submaps = {
            one.number: (one.session_id, one.ordinal) for one in self.read(lambda uow: uow.submaps.find(TENANT))
        }
        loops = self.read(lambda uow: uow.loops.find(TENANT, map_id="town"))
        changed = [one for loop in loops for one in (self.silenced(loop) if slipped else self.misplaced(loop))]
        self.world.context.transactions.write(lambda uow: [uow.loops.replace(one) for one in changed] and None).result()

    def at_of_s1(self, loop) -> list[int]:
        """The submaps of `s1` that a loop joins."""
        ends = [self.submaps[number] for number in (loop.query_number, loop.match_number)]
        return [at for session, at in ends if session == "s1"]

    def silenced(self, loop) -> Iterator:
        if any(at not in HEARD for at in self.at_of_s1(loop)):
            yield replace(loop, state="REJECTED", reason="AMBIGUOUS", graph_state=None)

    def misplaced(self, loop) -> Iterator:
        """`s1` lies aside where it is taken for another place."""
        if all(at < MISPLACED for at in self.at_of_s1(loop)):
            return
        taken_for = self.taken_for()
        query, match = (taken_for[number] for number in (loop.query_number, loop.match_number))
        yield replace(loop, T_match_query=pose_row(se3.inverse(match) @ query))

    def read(self, work):
        return self.world.context.transactions.read(work).result()

    def truth(self) -> dict[int, np.ndarray]:
        return {number: self.fleet.fleet.truth[session][at] for number, (session, at) in self.submaps.items()}

    def taken_for(self) -> dict[int, np.ndarray]:
        """The poses by which loops are misplaced."""
        there = {number for number, (session, at) in self.submaps.items() if session == "s1" and at >= MISPLACED}
        return {number: self.aside @ pose if number in there else pose for number, pose in self.truth().items()}

    def off_m(self, listed) -> float:
        poses = {
            s: np.stack([one.T_map_submap for one in listed if one.key.session_id == s]) for s in self.fleet.fleet.truth
        }
        return self.fleet.fleet.error_m(poses)

    async def optimised(self):
        """The summary of a version, the findings of `s1`, how far off its poses are, and how unsure, metres."""
        await self.world.use_cases.map_versions.optimise(TENANT, "town")
        self.world.work_off()
        version = await self.world.use_cases.map_versions.get(TENANT, "town", 1)
        session = await self.world.use_cases.sessions.get(TENANT, SessionKey("town", "s1"))
        listed = (await self.world.use_cases.map_versions.poses(TENANT, "town", 1, PageRequest(500))).items
        sigma = max(float(np.sqrt(np.trace(np.reshape(one.covariance, (6, 6))[:3, :3]))) for one in listed)
        codes = [one.code for one in session.findings if one.code.startswith("odometry_")]
        return version.summary, codes, self.off_m(listed), sigma


async def test_a_slip_of_a_short_drive_is_mended_where_surfaces_speak_against_the_odometry():
    drives = Drives(slipped=True)
    drives.world.merger = Surfaces(drives.truth())
    summary, codes, off_m, sigma_m = await drives.optimised()
    (fault,) = summary["odometry_faults"]
    assert (fault["kind"], fault["undecided"], codes) == ("SLIP", False, ["odometry_slip"])
    assert (summary["loops_set_aside"], off_m < 0.5) == (0, True)
    assert sigma_m > 4.5, "the submaps that it tears are as unsure as it is long"


async def test_a_slip_that_surfaces_do_not_decide_is_told_and_the_map_as_unsure_as_that():
    drives = Drives(slipped=True)
    drives.world.merger = Surfaces(None)
    summary, codes, off_m, sigma_m = await drives.optimised()
    (fault,) = summary["odometry_faults"]
    assert (fault["undecided"], codes) == (True, ["odometry_undecided"])
    assert summary["loops_set_aside"] > 0 and 1.0 < off_m < sigma_m


async def test_a_place_taken_for_another_one_is_no_fault_where_surfaces_agree_with_the_odometry():
    drives = Drives(slipped=False)
    drives.world.merger = Surfaces(drives.truth(), within_m=4.0)
    summary, codes, off_m, _ = await drives.optimised()
    assert (summary["odometry_faults"], codes) == ([], [])
    assert summary["loops_set_aside"] > 5 and off_m < 2.0


async def test_a_place_taken_for_another_one_is_told_where_surfaces_do_not_decide_and_moves_nothing():
    drives = Drives(slipped=False)
    drives.world.merger = Surfaces(None)
    summary, codes, off_m, _ = await drives.optimised()
    assert codes == ["odometry_undecided"]
    assert summary["loops_set_aside"] > 5 and off_m < 2.0


async def test_an_undecided_fault_is_told_where_surfaces_keep_the_drives_apart():
    drives = Drives(slipped=True)
    drives.world.merger = Contrary()
    summary, codes, _, _ = await drives.optimised()
    assert (summary["frames"], codes) == (2, ["odometry_undecided"])


FIRST = 8
"""Before it no loop of `s1` is known."""


class DoubtedBefore(Drives):
    """Drives of which one has slipped; right loops before that are ambiguous, as many more behind contradict them."""

    def silenced(self, loop) -> Iterator:
        at = min(self.at_of_s1(loop), default=60)
        if at < 30:
            evidence = loop.evidence | {"doubts": {"PAIRWISE_INCONSISTENT": {}} if at >= FIRST else {"BETTER": {}}}
            yield replace(loop, state="REJECTED", reason="AMBIGUOUS", graph_state=None, evidence=evidence)


async def test_a_slip_that_doubted_loops_show_is_mended_where_surfaces_would_keep_the_drives_apart():
    drives = DoubtedBefore(slipped=True)
    drives.world.merger = Surfaces(drives.truth())
    summary, codes, off_m, _ = await drives.optimised()
    (fault,) = summary["odometry_faults"]
    assert (fault["kind"], fault["undecided"], codes) == ("SLIP", False, ["odometry_slip"])
    assert (summary["frames"], summary["loops_set_aside"], off_m < 0.5) == (1, 0, True)
    await drives.optimised()
    again = (await drives.world.use_cases.map_versions.get(TENANT, "town", 2)).summary
    assert [one["kind"] for one in again["odometry_faults"]] == ["SLIP"], "the doubted loops may never be accepted"


async def test_a_slip_that_doubted_loops_show_and_surfaces_do_not_decide_is_told_beside_the_drives_kept_apart():
    drives = DoubtedBefore(slipped=True)
    drives.world.merger = Contrary()
    summary, codes, _, _ = await drives.optimised()
    assert (summary["frames"], codes) == (2, ["odometry_undecided"])


class DoubtedBetween(Drives):
    """Drives of which one has slipped over three steps; right loops of the submaps around these are ambiguous."""

    def silenced(self, loop) -> Iterator:
        for changed in super().silenced(loop):
            is_around = all(26 < at < 34 for at in self.at_of_s1(loop))
            doubts = {"PAIRWISE_INCONSISTENT": {}} if is_around else {"BETTER": {}}
            yield replace(changed, evidence=loop.evidence | {"doubts": doubts})


class AroundTheStep(Surfaces):
    """Surfaces that are seen beside some submaps alone."""

    def __init__(self, truth: dict[int, np.ndarray], seen: set[int]) -> None:
        super().__init__(truth)
        self._seen = seen

    def audit(self, first, second, surfaces, scale, most, progress) -> MergeEvidence:
        """Of other submaps no point is common."""
        found = super().audit(first, second, surfaces, scale, most, progress)
        return replace(found, common_points=0) if self._seen.isdisjoint(first) and most == FAULT_PAIRS else found


async def test_doubted_loops_tell_where_an_undecided_fault_lies_so_that_surfaces_decide():
    drives = DoubtedBetween(slipped=True, made=partial(slipped_fleet_in, sessions=3, steps=3))
    around = {number for number, (session, at) in drives.submaps.items() if session == "s1" and 24 < at < 36}
    drives.world.merger = AroundTheStep(drives.truth(), around)
    summary, codes, off_m, _ = await drives.optimised()
    assert (summary["frames"], summary["loops_set_aside"], off_m < 0.5) == (1, 0, True)
    assert ([one["undecided"] for one in summary["odometry_faults"]], codes) == ([False], ["odometry_slip"])


class Mostly(Surfaces):
    """Surfaces of drives that agree but for some submaps, too few for the audit of a join."""

    def audit(self, first, second, surfaces, scale, most, progress) -> MergeEvidence:
        """Those beside a fault decide as ever."""
        found = super().audit(first, second, surfaces, scale, most, progress)
        return found if most == FAULT_PAIRS else replace(found, seen_through_share=0.001)


async def test_a_slip_that_doubted_loops_show_is_mended_where_the_surfaces_of_most_of_a_drive_agree():
    drives = DoubtedBefore(slipped=True)
    drives.world.merger = Mostly(drives.truth())
    summary, codes, off_m, _ = await drives.optimised()
    assert (summary["frames"], codes, off_m < 0.5) == (1, ["odometry_slip"], True)


async def test_doubted_loops_that_surfaces_do_not_confirm_tell_nothing_of_drives_that_agree():
    drives = DoubtedBefore(slipped=True)
    drives.world.merger = Surfaces(None)
    summary, codes, _, _ = await drives.optimised()
    assert (summary["frames"], summary["odometry_faults"], codes) == (1, [], [])


class Stranger(FakeMerger):
    """Surfaces that speak against joins with a drive of these submaps, and decide on no fault."""

    def __init__(self, stranger: set[int]) -> None:
        self._stranger = stranger

    def audit(self, first, second, surfaces, scale, most, progress) -> MergeEvidence:
        """Nothing is read."""
        kept_apart = most != FAULT_PAIRS and self._stranger.isdisjoint(first) != self._stranger.isdisjoint(second)
        return MergeEvidence(5_000, 0.02, 0.01, 0.2 if kept_apart else 0.001)


async def test_an_undecided_fault_is_told_once_where_surfaces_keep_another_drive_apart():
    drives = Drives(slipped=True, made=partial(slipped_fleet_in, sessions=3))
    drives.world.merger = Stranger({number for number, (session, _) in drives.submaps.items() if session == "s2"})
    summary, codes, _, _ = await drives.optimised()
    assert (summary["frames"], len(summary["refused_joins"]), codes) == (2, 1, ["odometry_undecided"])
    assert len(summary["odometry_faults"]) == 1


async def test_a_place_that_looks_like_another_one_is_not_believed_for_a_fault_that_odometry_has_throughout():
    """Lengths are 8 % too large; without that, odometry carries the drive to where surfaces agree."""
    drives = Drives(slipped=False, aside_m=9.0, made=partial(lengthened_fleet_in, factor=1.08))
    drives.world.merger = Either(Surfaces(drives.truth(), 4.0), Surfaces(drives.taken_for(), 4.0))
    summary, codes, _, _ = await drives.optimised()
    assert {one["undecided"] for one in summary["odometry_faults"] if one["kind"] != "SCALE"} == {True}
    assert "odometry_undecided" in codes


async def test_a_robot_that_was_lifted_and_turned_is_told_and_mended_by_the_surfaces():
    drives = Drives(slipped=False, aside_m=0.0, made=lifted_fleet_in)
    drives.world.merger = Surfaces(drives.truth())
    summary, codes, off_m, _ = await drives.optimised()
    assert (codes, summary["loops_set_aside"], off_m < 0.5) == (["odometry_turn"], 0, True)


async def test_submaps_whose_windows_hold_a_slip_are_as_unsure_as_it_is_long():
    world = memory_world()
    slipped_fleet_in(world, "town")
    await world.use_cases.map_versions.optimise(TENANT, "town")
    world.work_off()
    listed = (await world.use_cases.map_versions.poses(TENANT, "town", 1, PageRequest(500))).items
    sigmas = {(one.key.session_id, n % 60): np.sqrt(np.trace(one.covariance[:3, :3])) for n, one in enumerate(listed)}
    unsure = sorted(key for key, sigma in sigmas.items() if sigma > 4.5)
    assert unsure == [("s1", 29), ("s1", 30)]
    assert max(sigma for key, sigma in sigmas.items() if key not in unsure) < 2.0


async def test_odometry_that_begins_anew_is_told_and_the_map_is_as_good_as_without_it():
    world = memory_world()
    made = restarted_fleet_in(world, "town")
    await world.use_cases.map_versions.optimise(TENANT, "town")
    world.work_off()
    version = await world.use_cases.map_versions.get(TENANT, "town", 1)
    listed = (await world.use_cases.map_versions.poses(TENANT, "town", 1, PageRequest(500))).items
    poses = {s: np.stack([one.T_map_submap for one in listed if one.key.session_id == s]) for s in made.fleet.truth}
    assert made.fleet.error_m(poses) < 0.5
    assert version.summary["loops_set_aside"] == 0
    session = await world.use_cases.sessions.get(TENANT, SessionKey("town", "s1"))
    (told,) = (one for one in session.findings if one.odometry_fault)
    assert (told.code, told.odometry_fault.first_submap, told.odometry_fault.last_submap) == (
        "odometry_jump", "maps/town/sessions/s1/submaps/029", "maps/town/sessions/s1/submaps/030"
    )  # fmt: skip
    assert re.search("jumped by [0-9]+ m .standard deviation 10., as the time between them says", told.cause)
