"""A simulated drive around a block, its scans encoded once as the SDK sends them, to be driven again and again.

Making a scan of 64 beams costs some 0.1 s of a core. Robots in a test of load share two cores with the service, so
their scans are made beforehand, kept in one file, and sent again with other times and poses.
"""

from __future__ import annotations

import json
import mmap
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from revisit import Cloud
from revisit.core.config import SubmapConfig
from revisit.core.geometry import se3
from revisit.core.geometry.path import travelled_m
from revisit.core.scan_marks import ScanMarks, marked_rows
from revisit.evaluation.simulator import HDL64, StreetGrid, Trajectory, build_city, drive, grid_drive, simulate
from revisit.formats import QUANTISED
from revisit.sdk.clouds import encoded

ROUND = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]
"""Crossings of the streets around one block."""

UNIT_AT = 8
"""Where the unit stands in a quantised cloud (`revisit.formats.quantised`)."""

LAPS = 5
"""More than a robot drives."""

ENOUGH_RETURNS = 100_000
"""As many as 64 beams have at least: marks are as far apart as they may be."""

SEED = 5
SPEED_MPS = 1.5
SCANS_PER_S = 10.0


@dataclass(frozen=True)
class RecordedDrive:
    """Scans as they are sent, and where each was taken from, (n, 4, 4), on a round that is driven again and again.

    way_m (n,): metres that were travelled up to each scan over poses a tenth of a second apart; round_m: up to the
    first one again.
    """

    scans: mmap.mmap
    ends: NDArray[np.int64]
    points: NDArray[np.int64]
    T_world_sensor: NDArray[np.float64]
    way_m: NDArray[np.float64]
    round_m: float

    def __len__(self) -> int:
        return len(self.ends)

    def cloud(self, index: int) -> Cloud:
        """The scan taken at place `index` of the round."""
        start = 0 if index == 0 else int(self.ends[index - 1])
        return Cloud(self.scans[start : int(self.ends[index])], QUANTISED)

    def bytes_a_scan(self) -> float:
        """Mean size on the wire."""
        return float(self.ends[-1]) / len(self)


@dataclass(frozen=True)
class Lap:
    """Robot number `robot` drives round and round from place `start` on; its odometry begins there, without drift."""

    drive: RecordedDrive
    robot: int
    start: int

    def scan(self, number: int) -> tuple[Cloud, NDArray[np.float64]]:
        """Scan 0, 1, 2, ...: its cloud and T_odom_sensor."""
        lap, index = divmod(self.start + number, len(self.drive))
        T_odom_world = se3.inverse(self.drive.T_world_sensor[self.start])
        cloud = _made_different(self.drive.cloud(index), LAPS * self.robot + lap)
        return cloud, T_odom_world @ self.drive.T_world_sensor[index]

    def way_m(self, number: int) -> float:
        """Metres travelled up to scan 0, 1, 2, ..."""
        lap, index = divmod(self.start + number, len(self.drive))
        return float(lap * self.drive.round_m + self.drive.way_m[index] - self.drive.way_m[self.start])

    def scans_within(self, way_m: float) -> int:
        """How many scans are taken on so many metres."""
        count = 0
        while self.way_m(count) < way_m:
            count += 1
        return count


def _made_different(cloud: Cloud, by: int) -> Cloud:
    """The same scan with other bytes: the same content is stored once, however often a robot comes by.

    The unit of its coordinates, 1 mm, is changed by 2e-7 of itself; by 0.8 mm at 80 m for `by` = 50.
    """
    unit = struct.pack("<f", 0.001 * (1 + 2e-7 * by))
    return Cloud(cloud.data[:UNIT_AT] + unit + cloud.data[UNIT_AT + 4 :], cloud.content_type)


def recorded_drive(folder: Path, scans: int | None, block_m: float, *, described: bool = False) -> RecordedDrive:
    """The drive in `folder`, made first where it is not there: the first `scans` of it, or the whole round.

    A whole round of a block of 85 m is 366 m: 2,439 scans, four minutes of a core, 740 MB. Of a drive from which
    descriptions alone are made, those that are chosen at marks are kept, one of thirteen.
    """
    if not (folder / "drive.json").exists():
        _record(folder, scans, block_m, described=described)
    told = json.loads((folder / "drive.json").read_text())
    with (folder / "scans.bin").open("rb") as file:
        content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    poses = np.load(folder / "poses.npy")
    ends, points = np.array(told["ends"]), np.array(told["points"])
    return RecordedDrive(content, ends, points, poses, np.array(told["way_m"]), told["round_m"])


def _record(folder: Path, scans: int | None, block_m: float, *, described: bool) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    grid = StreetGrid.random(3, 3, SEED, block_m)
    path = grid_drive(grid, ROUND)
    world = build_city(grid.streets(), SEED, drive=path)
    trajectory = drive(path, world.ground, spacing_m=SPEED_MPS / SCANS_PER_S, speed_mps=SPEED_MPS)
    poses = trajectory.T_world_sensor[:scans]
    way_m = travelled_m(np.vstack([poses[:, :3, 3], poses[:1, :3, 3]]))
    rows = np.arange(len(poses))
    if described:
        rows = np.array(marked_rows(((pose, ENOUGH_RETURNS) for pose in poses), ScanMarks.of(SubmapConfig())))
    ends, points = [], []
    with (folder / "scans.bin").open("wb") as file:
        for scan in simulate(world, Trajectory(poses[rows], trajectory.stamps_ns[rows]), HDL64, SEED):
            file.write(encoded(scan.points).data)
            ends.append(file.tell())
            points.append(len(scan.points))
    np.save(folder / "poses.npy", poses[rows])
    told = {"ends": ends, "points": points, "way_m": way_m[rows].tolist(), "round_m": float(way_m[-1])}
    (folder / "drive.json").write_text(json.dumps(told))
