"""A window of many dense scans takes a worker no more memory than that of a few."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from revisit.core.geometry import se3
from revisit.service.application.contract.records import ScanRecord
from revisit.service.application.ingest.submap_source import MAX_SCANS, submap_source
from tests.support.service_world import TENANT, memory_world, open_session, scan


async def test_of_a_window_of_dense_scans_only_the_used_ones_are_read(monkeypatch):
    world = memory_world()
    await open_session(world)
    for seq in range(1, 12):
        await world.use_cases.scans.append(TENANT, scan(seq, float(seq - 1)))

    def dense(uow) -> tuple[int, int]:
        (record,) = uow.submaps.find(TENANT)
        first: ScanRecord = uow.scans.with_seqs(TENANT, record.map_id, record.session_id, [1])[0]
        taken_at_m = np.linspace(0.0, 10.0, MAX_SCANS)
        poses = [tuple(se3.from_yaw(0.0, (at_m, 0.0, 0.0)).ravel().tolist()) for at_m in taken_at_m]
        dense = [replace(first, point_count=262_000, T_odom_sensor=pose) for pose in poses]
        monkeypatch.setattr(type(uow.scans), "with_seqs", lambda *_: dense)
        used = submap_source(uow, world.context.policy, record).clouds
        return len(used), 262_000 * len(used)

    scans, points = world.context.transactions.read(dense).result()
    assert scans == 11
    assert points < 3_000_000
