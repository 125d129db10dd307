"""The faults of a session's odometry in the map that its own was merged into: made-up fleets."""

from __future__ import annotations

from dataclasses import replace

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_matrix, pose_row, position_row
from revisit.service.domain.identity import SessionKey
from revisit.service.features.merging.calls import MergeMap
from tests.support.fleet_in_service import fleet_in_two
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
