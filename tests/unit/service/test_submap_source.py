"""Of a window that is too long for one submap, only the scans that are used are read."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from revisit.core.config import PipelineConfig, SubmapConfig
from revisit.core.geometry.se3 import pose_matrix, pose_row
from revisit.service.domain.limits import SCAN_POINTS
from revisit.service.features.ingest import rows as submap_source
from revisit.service.features.ingest.rows import MAX_SCANS, spread_rows
from tests.support.service_world import TENANT, memory_world, open_session, pose, scan


def test_all_scans_of_a_window_are_chosen_up_to_the_limit():
    assert spread_rows(7, 7) == [7]
    assert spread_rows(7, 6 + MAX_SCANS) == list(range(7, 7 + MAX_SCANS))


def test_of_an_hour_at_a_red_light_a_bounded_number_is_chosen_evenly_and_with_both_ends():
    chosen = spread_rows(101, 36_100)
    steps = {later - earlier for earlier, later in pairwise(chosen)}
    assert (len(chosen), chosen[0], chosen[-1]) == (MAX_SCANS, 101, 36_100)
    # 35,999 / 399 = 90.2 scans apart.
    assert steps == {90, 91}


async def test_of_a_slow_robots_dense_scans_only_those_at_marks_are_read():
    world = memory_world(pipeline=PipelineConfig(submap=SubmapConfig(enough_returns=0)))
    await open_session(world)
    for seq in range(1, 76):
        await world.use_cases.scans.append(TENANT, scan(seq, 0.15 * (seq - 1)))
    (record,) = world.context.transactions.read(lambda uow: uow.submaps.find(TENANT)).result()
    source = world.context.transactions.read(
        lambda uow: submap_source.submap_source(uow, world.context.policy, record)
    ).result()
    assert record.scan_count == len(source.clouds) == 7
    assert record.last_seq - record.first_seq > 60
    assert submap_source.load_submap(world.context.blobs, record, source).T_odom_submap == pytest.approx(
        pose_matrix(record.T_odom_submap)
    )


@pytest.mark.parametrize("travelled_m", [np.linspace(0.0, 10.0, MAX_SCANS), np.zeros(MAX_SCANS)], ids=["slow", "still"])
async def test_an_old_window_of_many_large_scans_takes_a_worker_the_memory_of_a_few(travelled_m, monkeypatch):
    world = memory_world()
    await open_session(world)
    for seq in range(1, 12):
        await world.use_cases.scans.append(TENANT, scan(seq, float(seq - 1)))

    def clouds(uow):
        (record,) = uow.submaps.find(TENANT)
        first = uow.scans.with_seqs(TENANT, record.map_id, record.session_id, [1])[0]
        taken = [replace(first, point_count=SCAN_POINTS, T_odom_sensor=pose_row(pose(x))) for x in travelled_m]
        monkeypatch.setattr(type(uow.scans), "with_seqs", lambda *_: taken)
        monkeypatch.setattr(type(uow.scans), "chosen_between", lambda *_: [])
        return submap_source.submap_source(uow, world.context.policy, record).clouds

    assert 1 <= len(world.context.transactions.read(clouds).result()) <= 6
