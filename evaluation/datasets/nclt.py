"""NCLT: velodyne_sync/*.bin named by microseconds, groundtruth_DATE.csv of the robot's body (x ahead, y right, z down).

The hits of velodyne_sync are in the body frame, so body and sensor frame are one. Both are turned by half a turn about
x here: x ahead, y left, z up.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np

from revisit.core.errors import MalformedBody
from revisit.core.geometry import se3
from revisit.core.point_columns import INTENSITY, RING, USUAL, only
from revisit.evaluation.datasets.number_rows import read_rows
from revisit.evaluation.datasets.posed_clouds import PosedClouds, StampedPoses, interpolated, named_scans
from revisit.formats import DecodedCloud

_HIT = np.dtype([("xyz", "<u2", 3), ("intensity", "u1"), ("beam", "u1")])
_UNIT_M, _OFFSET_M = 0.005, -100.0
_Z_UP = np.diag([1.0, -1.0, -1.0, 1.0])


def open_nclt(folder: Path) -> PosedClouds:
    """A session (`2012-01-08`), its ground truth inside, beside it, or in ../ground_truth.

    Raises FileNotFoundError for missing files, MalformedBody for unreadable ones, BadField for names that are no times.
    """
    date = folder.resolve().name
    rows = read_rows(_ground_truth(folder.resolve(), date), 7)
    rows = rows[np.isfinite(rows).all(axis=1)]
    stamps_ns, first = np.unique(rows[:, 0].astype(np.int64) * 1000, return_index=True)
    T_world_body = np.stack([_Z_UP @ _pose(row) @ _Z_UP for row in rows[first, 1:]])
    scans = named_scans(folder / "velodyne_sync", "*.bin", ns_per_unit=1000)
    return interpolated(date, scans, StampedPoses(stamps_ns, T_world_body), np.eye(4), read_hits)


def read_hits(file: Path, wanted: Collection[str] = USUAL) -> DecodedCloud:
    """The points of a velodyne_sync file, z up: 16 bit without sign, 5 mm a unit, from -100 m; intensity and ring.

    Raises MalformedBody for a torn file.
    """
    raw = file.read_bytes()
    if len(raw) % _HIT.itemsize:
        raise MalformedBody(f"{file.name} holds {len(raw)} bytes, which is no multiple of {_HIT.itemsize}")
    hits = np.frombuffer(raw, dtype=_HIT)
    points = (hits["xyz"] * _UNIT_M + _OFFSET_M) * [1.0, -1.0, -1.0]
    columns = {INTENSITY.name: hits["intensity"].astype(np.float32), RING.name: hits["beam"]}
    return DecodedCloud(np.asarray(points, dtype=np.float32), only(columns, wanted))


def _ground_truth(folder: Path, date: str) -> Path:
    name = f"groundtruth_{date}.csv"
    for file in (folder / name, folder.parent / name, folder.parent / "ground_truth" / name):
        if file.exists():
            return file
    raise FileNotFoundError(f"no {name} in or beside {folder}")


def _pose(row: np.ndarray[tuple[int], np.dtype[np.float64]]) -> se3.Matrix4:
    """T of x, y, z metres and roll, pitch, heading radians: Rz(heading) Ry(pitch) Rx(roll)."""
    x, y, z, roll, pitch, heading = row
    turn = se3.from_yaw(heading, (x, y, z)) @ se3.exp((0, 0, 0, 0, pitch, 0)) @ se3.exp((0, 0, 0, roll, 0, 0))
    return np.asarray(turn)
