"""Of a window that is too long for one submap, only the scans that are used are read."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from revisit.core.geometry.se3 import pose_row
from revisit.service.application.ingest import submap_source
from revisit.service.application.ingest.submap_source import MAX_SCANS, chosen_seqs
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


async def test_a_window_of_many_dense_scans_is_described_from_some_of_them_in_the_frame_of_its_row(monkeypatch):
    monkeypatch.setattr(submap_source, "used_scans", lambda *_: np.array([0, 2, 3, 10]))
    world = memory_world()
    await open_session(world)
    for seq in range(1, 12):
        await world.use_cases.scans.append(TENANT, scan(seq, float(seq - 1)))
    (record,) = world.context.transactions.read(lambda uow: uow.submaps.find(TENANT)).result()
    source = world.context.transactions.read(
        lambda uow: submap_source.submap_source(uow, world.context.policy, record)
    ).result()
    loaded = submap_source.load_submap(world.context.blobs, record, source)
    assert (record.scan_count, loaded.scan_count) == (11, 4)
    np.testing.assert_allclose(pose_row(loaded.T_odom_submap), record.T_odom_submap)
    # The middle of eleven scans is that at 5 m.
    np.testing.assert_allclose(loaded.origins[:, 0], [-5.0, -3.0, -2.0, 5.0], atol=1e-5)
