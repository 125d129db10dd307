"""Of a window that is too long for one submap, only the scans that are used are read."""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import pytest

from revisit.core.config import SubmapConfig
from revisit.core.geometry.se3 import pose_matrix
from revisit.core.submap import chosen_scans
from revisit.service.application.ingest import submap_source
from revisit.service.application.ingest.submap_source import MAX_SCANS, WINDOW_POINTS, PosedCloud, chosen_seqs
from tests.support.service_world import TENANT, memory_world, open_session, scan


def test_all_scans_of_a_window_are_chosen_up_to_the_limit():
    assert chosen_seqs(7, 7) == [7]
    assert chosen_seqs(7, 6 + MAX_SCANS) == list(range(7, 7 + MAX_SCANS))


def test_of_an_hour_at_a_red_light_a_bounded_number_is_chosen_evenly_and_with_both_ends():
    chosen = chosen_seqs(101, 36_100)
    steps = {later - earlier for earlier, later in pairwise(chosen)}
    assert (len(chosen), chosen[0], chosen[-1]) == (MAX_SCANS, 101, 36_100)
    # 35,999 / 399 = 90.2 scans apart.
    assert steps == {90, 91}


@pytest.mark.parametrize(
    ("scans", "points", "every"),
    [(1, 1, 1), (MAX_SCANS, WINDOW_POINTS // MAX_SCANS, 1), (MAX_SCANS, 262_000, 7), (MAX_SCANS, 500_000, 13)],
)
def test_of_the_points_of_a_window_so_many_are_used_that_a_worker_has_room(scans, points, every):
    clouds = (PosedCloud("sha", points, (), 1),) * scans
    source = submap_source.SubmapSource(clouds, posted=False, config=None, T_odom_submap=())
    assert source.every == every
    assert scans * points / source.every <= WINDOW_POINTS


async def test_a_window_of_too_many_points_is_described_from_some_of_each_scan(monkeypatch):
    monkeypatch.setattr(submap_source, "WINDOW_POINTS", 1_000)
    world = memory_world()
    await open_session(world)
    for seq in range(1, 12):
        await world.use_cases.scans.append(TENANT, scan(seq, float(seq - 1)))
    (record,) = world.context.transactions.read(lambda uow: uow.submaps.find(TENANT)).result()
    source = world.context.transactions.read(
        lambda uow: submap_source.submap_source(uow, world.context.policy, record)
    ).result()
    loaded = submap_source.load_submap(world.context.blobs, record, source)
    assert (record.point_count, source.every) == (3_300, 4)
    assert len(loaded.points) == 11 * 75
    assert set(loaded.scan_index.tolist()) == set(range(11))


async def test_of_a_slow_robots_dense_scans_only_those_a_metre_apart_are_read(monkeypatch):
    as_of_64_beams = partial(chosen_scans, config=SubmapConfig(enough_returns=0))
    monkeypatch.setattr(submap_source, "chosen_scans", lambda positions, returns, _: as_of_64_beams(positions, returns))
    world = memory_world()
    await open_session(world)
    for seq in range(1, 70):
        await world.use_cases.scans.append(TENANT, scan(seq, 0.15 * (seq - 1)))
    (record,) = world.context.transactions.read(lambda uow: uow.submaps.find(TENANT)).result()
    source = world.context.transactions.read(
        lambda uow: submap_source.submap_source(uow, world.context.policy, record)
    ).result()
    assert record.scan_count > 60 and len(source.clouds) == 11
    assert submap_source.load_submap(world.context.blobs, record, source).T_odom_submap == pytest.approx(
        pose_matrix(record.T_odom_submap)
    )
