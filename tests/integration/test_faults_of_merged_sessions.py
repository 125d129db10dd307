"""The faults of a session's odometry in the map that its own was merged into: made-up fleets."""

from __future__ import annotations

from dataclasses import replace

import pytest

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_matrix, pose_row, position_row
from revisit.core.pose_graph.faults import FaultKind, OdometryFault
from revisit.service.domain.identity import SessionKey
from revisit.service.domain.states import SubmapState
from revisit.service.features.merging.calls import MergeMap
from tests.support.fake_merger import FakeMerger
from tests.support.fleet_in_service import fleet_in_two
from tests.support.made_up_anchors import new_anchors
from tests.support.service_world import TENANT, memory_world


def slip(uow, map_id, session_id, at, metres):
    """The odometry of a stored session loses a length of way at one of its submaps."""
    rows = uow.submaps.find(TENANT, map_id=map_id, session_id=session_id)
    before = pose_matrix(rows[at - 1].T_odom_submap)
    lost = before @ se3.from_yaw(0.0, (-metres, 0.0, 0.0)) @ se3.inverse(before)
    for row in rows[at:]:
        pose = lost @ pose_matrix(row.T_odom_submap)
        uow.submaps.replace(replace(row, T_odom_submap=pose_row(pose), position_m=position_row(pose[:3, 3])))


async def test_a_session_that_came_by_a_merge_has_the_findings_of_its_odometry():
    world = memory_world()
    fleet_in_two(world, ("town", "other"), seed=4, sessions=4, submaps=60, per_pair=90)
    world.context.transactions.write(lambda uow: slip(uow, "other", "s3", 30, 5.0)).result()
    await world.use_cases.map_merges.merge(TENANT, MergeMap("town", "other"))
    world.work_off()
    found = [await world.use_cases.sessions.get(TENANT, SessionKey("town", one)) for one in ("s0", "s1", "s3")]
    codes = [[one.code for one in session.findings if one.code.startswith("odometry_")] for session in found]
    assert codes == [[], [], ["odometry_slip"]]


class Finding(FakeMerger):
    """A merger that finds a fault of a merged session, which is undecided or not."""

    def __init__(self, undecided: bool) -> None:
        self._undecided = undecided

    def align(self, graph, *asked):
        """With the fault."""
        aligned, track = super().align(graph, *asked), graph.tracks[-1]
        fault = OdometryFault(str(track.session_number), FaultKind.SLIP, 5, 6, 5.0, 0.1, 9, self._undecided)
        return replace(aligned, optimised=replace(aligned.optimised, faults=(fault,)))


@pytest.mark.parametrize("undecided", [True, False])
async def test_a_version_follows_a_merge_that_has_not_asked_surfaces_of_a_fault(undecided):
    world = memory_world(optimise_after_loops=100)
    fleet_in_two(world, ("town", "other"), sessions=2, submaps=20, per_pair=0)
    world.merger = Finding(undecided)
    await world.use_cases.map_merges.merge(TENANT, MergeMap("town", "other"))
    world.work_off()
    jobs = world.context.transactions.read(lambda uow: uow.jobs.find(TENANT)).result()
    assert [one.kind for one in jobs if one.kind == "OPTIMISE_MAP"] == ["OPTIMISE_MAP"] * undecided


class Asked(FakeMerger):
    """A merger that keeps the graph that it was asked about."""

    def align(self, graph, *asked):
        """As ever."""
        self.graph = graph
        return super().align(graph, *asked)


def restarted(uow, map_id, session_id, at, without):
    """Submaps have times; the odometry begins anew at one of them, and some are not described."""
    rows = uow.submaps.find(TENANT, map_id=map_id, session_id=session_id)
    anew = pose_matrix(rows[0].T_odom_submap) @ se3.inverse(pose_matrix(rows[at].T_odom_submap))
    for n, row in enumerate(rows):
        pose = pose_matrix(row.T_odom_submap) if n < at else anew @ pose_matrix(row.T_odom_submap)
        state = SubmapState.FAILED if n in without else row.state
        own = replace(row, T_odom_submap=pose_row(pose), position_m=position_row(pose[:3, 3]), state=state)
        uow.submaps.replace(replace(own, stamp_ns=1_000 * n))


async def test_a_source_some_submaps_of_which_are_not_described_keeps_its_jumps_and_its_other_anchors():
    world = memory_world()
    made = fleet_in_two(world, ("town", "other"), seed=4, sessions=4, submaps=60, per_pair=90).fleet
    world.context.transactions.write(lambda uow: restarted(uow, "other", "s3", 30, {4, 5, 29, 40})).result()
    await world.use_cases.anchors.post(TENANT, SessionKey("other", "s3"), new_anchors(made, "s3"))
    world.merger = Asked()
    await world.use_cases.map_merges.merge(TENANT, MergeMap("town", "other"))
    world.work_off()
    (job,) = world.context.transactions.read(lambda uow: uow.jobs.find(TENANT, kind="MERGE_MAP")).result()
    assert job.result is not None
    assert [track.jumps for track in world.merger.graph.tracks] == [(), (), (), (26,)]
