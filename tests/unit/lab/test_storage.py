"""What a kilometre takes in the store."""

from __future__ import annotations

import numpy as np

from lab.storage.bytes_a_kilometre import StoredBytes, storage_table, stored_bytes
from revisit.core.config import SubmapConfig
from revisit.core.scan import Scan
from revisit.formats import quantised


def test_a_kilometre_is_so_many_scans_and_a_submap_each_stride():
    row = StoredBytes("64 beams", 100_000.0, 300_000.0, 30_000.0, 16_000.0, 4_000.0, stride_m=5.0)
    assert row.megabytes_a_km(1.0) == (300.0, 10.0)
    line = storage_table([row]).splitlines()[-1]
    assert line == "| 64 beams | 100,000 | 300.0 kB | 30.0 kB | 16.0 kB | 4.0 kB | 300 / 2000 MB | 10.0 MB |"


def test_bytes_of_a_drive_are_means_over_its_scans_and_submaps():
    rng = np.random.default_rng(0)
    room = rng.uniform(-6, 6, (4_000, 3)) * [1, 1, 0.3]
    room[:2_000, 0] = np.sign(room[:2_000, 0]) * 6
    scans = []
    for step in range(8):
        pose = np.eye(4)
        pose[0, 3] = 0.5 * step
        scans.append(Scan.validated(room.astype(np.float32), pose, 1_000 * step))
    row = stored_bytes("room", scans, SubmapConfig(tau=2.0, stride=1.0))
    assert row.returns == 4_000 and row.stride_m == 1.0 and row.descriptor == 4 * 1_024
    assert row.scan == len(quantised.encode(scans[0].points))
    assert 100 < row.place < 20_000 and 100 < row.neural_map < 100_000
