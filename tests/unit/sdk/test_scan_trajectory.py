"""Each scan goes with the submaps about it: their corrections, blended by the way between them."""

from __future__ import annotations

import numpy as np

from revisit.cli.scan_trajectory import Correction, corrected
from revisit.core.geometry import se3


def test_scans_of_a_drive_that_is_only_moved_keep_their_odometry():
    T_map_odom = se3.from_yaw(0.7, (100.0, -20.0, 3.0))
    stamps = np.arange(20, dtype=np.int64) * 10**8
    poses = [se3.from_yaw(0.1 * n, (float(n), 0.0, 0.0)) for n in range(20)]
    corrections = [Correction(int(stamps[n]), T_map_odom) for n in (5, 10, 15)]
    for found, pose in zip(corrected(stamps, poses, corrections), poses, strict=True):
        np.testing.assert_allclose(found, T_map_odom @ pose, atol=1e-9)


def test_a_correction_that_grows_is_blended_by_the_way_and_not_by_the_time():
    # Ten metres, then a stop of a minute half way between the two submaps, then ten metres more.
    x_m = np.concatenate([np.arange(11.0), np.full(600, 10.0), np.arange(11.0, 21.0)])
    stamps = np.arange(len(x_m), dtype=np.int64) * 10**8
    poses = [se3.from_yaw(0.0, (x, 0.0, 0.0)) for x in x_m]
    ends = [Correction(int(stamps[0]), np.eye(4)), Correction(int(stamps[-1]), se3.from_yaw(0.0, (0.0, 2.0, 0.0)))]
    y_m = np.array([found[1, 3] for found in corrected(stamps, poses, ends)])
    np.testing.assert_allclose(y_m, 0.1 * x_m, atol=1e-3)


def test_scans_before_the_first_and_behind_the_last_submap_go_with_it():
    stamps = np.arange(4, dtype=np.int64) * 10**8
    poses = [se3.from_yaw(0.0, (float(n), 0.0, 0.0)) for n in range(4)]
    lifted = se3.from_yaw(0.0, (0.0, 0.0, 1.0))
    found = corrected(stamps, poses, [Correction(int(stamps[1]), lifted)])
    assert [float(one[2, 3]) for one in found] == [1.0] * 4
