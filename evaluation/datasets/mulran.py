"""MulRan: Ouster/*.bin named by nanoseconds, global_pose.csv with the pose of the car at its own times."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from revisit.core.geometry import se3
from revisit.evaluation.datasets.kitti import read_velodyne
from revisit.evaluation.datasets.number_rows import read_rows, read_words
from revisit.evaluation.datasets.posed_clouds import PosedClouds, StampedPoses, interpolated, named_scans

# calib_base2ouster.txt of the data set: 1.7042, -0.021, 1.8047 m, roll 0.0001, pitch 0.0003, yaw 179.6654 degrees.
T_BASE_OUSTER = (
    se3.from_yaw(np.radians(179.6654), (1.7042, -0.021, 1.8047))
    @ se3.exp((0, 0, 0, 0, np.radians(0.0003), 0))
    @ se3.exp((0, 0, 0, np.radians(0.0001), 0, 0))
)


def open_mulran(folder: Path) -> PosedClouds:
    """A sequence (`DCC01`). Poses are interpolated; scans outside their times are left out.

    Raises FileNotFoundError for missing files, MalformedBody for unreadable ones, BadField for names that are no times.
    """
    rows = read_rows(folder / "global_pose.csv", 13)
    # The first column has 19 digits, which a float64 does not hold: it is read once more as an integer.
    stamps_ns = np.array([int(words[0].partition(".")[0]) for words in read_words(folder / "global_pose.csv")])
    poses = StampedPoses(*_in_order(stamps_ns, np.stack([se3.validated(row.reshape(3, 4)) for row in rows[:, 1:]])))
    scans = named_scans(folder / "Ouster", "*.bin", ns_per_unit=1)
    return interpolated(folder.resolve().name, scans, poses, T_BASE_OUSTER, read_velodyne)


def _in_order(
    stamps_ns: np.ndarray[tuple[int], np.dtype[np.int64]], poses: np.ndarray[tuple[int, ...], np.dtype[np.float64]]
) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
    """By rising time, each time once: the published files repeat some rows."""
    unique, first = np.unique(stamps_ns, return_index=True)
    return unique, poses[first]
