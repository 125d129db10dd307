"""Any folder of clouds (.pcd, .ply, .bin, .npy) with a trajectory in TUM, KITTI or g2o format."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField, MalformedBody
from revisit.core.geometry import se3
from revisit.core.point_columns import USUAL
from revisit.evaluation.datasets.lidar_odometry import KISS_ICP, Report, odometry_of
from revisit.evaluation.datasets.number_rows import MICROSECOND_DIGITS, nanoseconds, read_rows, read_times, read_words
from revisit.evaluation.datasets.posed_clouds import (
    PosedClouds,
    StampedPoses,
    Stamps,
    in_number_order,
    interpolated,
    posed,
)
from revisit.formats import DecodedCloud, decode_cloud, media_type_for_suffix

SCAN_PERIOD_NS = 100_000_000
_TIMES = "times.txt"
_SUFFIXES = (".pcd", ".ply", ".bin", ".npy")
_CLOUD_FOLDERS = ("clouds", "scans", "velodyne", ".")
_POSE_FILES = (
    "poses.txt", "poses.tum", "trajectory.txt", "trajectory.tum", "traj.txt", "poses.kitti", "poses.g2o", "graph.g2o",
)  # fmt: skip
_OF_ODOMETRIES = ("*_tum.txt", "*_kitti.txt", "odom_lidar.txt", "traj_lidar.txt")
"""Trajectories of KISS-ICP in `results/latest`, and of GLIM in its dump: odometry before optimised poses."""
_OUTPUT_FOLDERS = (".", "results/latest", "dump")


def open_cloud_folder(folder: Path, poses: Path | None = None) -> PosedClouds:
    """Clouds in `clouds/`, `scans/`, `velodyne/` or the folder itself, and the LiDAR's poses (z up).

    These are in the file `poses`, else beside the clouds, or where KISS-ICP and GLIM leave them.

    Rows of 8 numbers are TUM (seconds, x, y, z, qx, qy, qz, qw), rows of 12 KITTI, without times 0.1 s apart. As many
    rows as clouds are taken one by one, unless the clouds are named by their times (seconds with a point, or
    nanoseconds, microseconds by their length), which pass otherwise than those of the rows: then, and where there are
    more rows or fewer, TUM poses are interpolated. Of a g2o file the vertices are taken by their number, one for each
    cloud, 0.1 s apart; edges are not needed. Raises FileNotFoundError, MalformedBody, BadField, BadTransform.
    """
    name, files = folder.resolve().name, _clouds(folder)
    poses = poses or _pose_file(folder)
    if poses.suffix == ".g2o":
        vertices = _g2o(poses)
        if len(vertices) != len(files):
            raise BadField(f"{poses.name} has {len(vertices)} vertices for {len(files)} clouds", field=poses.name)
        return posed(name, files, vertices, _regular(len(vertices)), read_cloud)
    width = len(read_words(poses)[0]) if read_words(poses) else 0
    if width not in (8, 12):
        raise MalformedBody(f"{poses.name} must hold 8 (TUM) or 12 (KITTI) numbers a line, got {width}")
    rows = read_rows(poses, width)
    stamps, matrices = _tum(poses, rows) if width == 8 else _kitti(rows)
    named = _times_in_names(files) if width == 8 else None
    if len(rows) == len(files) and (named is None or _pass_alike(named, stamps)):
        return posed(name, files, list(matrices), stamps, read_cloud)
    if named is None:
        why = "" if width == 12 else f", and {files[0].name} is not named by its time"
        raise BadField(f"{poses.name} has {len(rows)} rows for {len(files)} clouds{why}", field=poses.name)
    return interpolated(name, (files, named), StampedPoses(stamps, matrices), np.eye(4), read_cloud)


def open_unposed_clouds(folder: Path, report: Report | None = None, limit: int | None = None) -> PosedClouds:
    """Clouds as `open_cloud_folder` finds them, their poses by KISS-ICP from the clouds themselves.

    Times are those of `times.txt` (seconds, one a cloud), else those that the files are named by, else 0.1 s apart.
    Only the first `limit` clouds are read. Raises FileNotFoundError, ImportError without KISS-ICP, and as a damaged
    cloud does.
    """
    files = _clouds(folder)
    wanted = files[:limit]
    odometry = odometry_of(lambda index: read_cloud(wanted[index]).points, len(wanted), report)
    stamps = _stamps(folder, files)[:limit]
    clouds = posed(folder.resolve().name, wanted, list(odometry.T_odom_sensor), stamps, read_cloud)
    return replace(clouds, notes=odometry.notes(), unposed=len(files) - len(wanted))


def _stamps(folder: Path, files: list[Path]) -> Stamps:
    """The times of clouds without poses."""
    if (folder / _TIMES).is_file() and len(times := read_times(folder / _TIMES)) == len(files):
        return times
    named = _times_in_names(files)
    return _regular(len(files)) if named is None else named


def read_cloud(file: Path, columns: Collection[str] = USUAL) -> DecodedCloud:
    """A cloud file, by the product's own parsers. Raises MalformedBody, UnsupportedEncoding."""
    return decode_cloud(file.read_bytes(), media_type_for_suffix(file.suffix), wanted=columns)


def _clouds(folder: Path) -> list[Path]:
    for name in _CLOUD_FOLDERS:
        found = [file for file in (folder / name).glob("*") if file.suffix.lower() in _SUFFIXES]
        if found:
            return in_number_order(found)
    raise FileNotFoundError(f"no clouds ({', '.join(_SUFFIXES)}) in {folder}")


def _pose_file(folder: Path) -> Path:
    for name in _POSE_FILES:
        if (folder / name).exists():
            return folder / name
    for output in _OUTPUT_FOLDERS:
        for pattern in _OF_ODOMETRIES:
            for file in sorted((folder / output).glob(pattern)):
                return file
    raise FileNotFoundError(
        f"no odometry for the clouds in {folder}: neither {', '.join(_POSE_FILES)}, nor a file of KISS-ICP or GLIM. "
        "Name one with --poses FILE (TUM or KITTI), or let KISS-ICP make one from the clouds alone: "
        f"--odometry {KISS_ICP} (pip install 'revisit-loops[{KISS_ICP}]')"
    )


def _tum(file: Path, rows: NDArray[np.float64]) -> tuple[Stamps, NDArray[np.float64]]:
    """Times, read as text so that no nanosecond is lost, and poses."""
    return read_times(file), np.stack([se3.from_quaternion(row[4:], row[1:4]) for row in rows])


def _kitti(rows: NDArray[np.float64]) -> tuple[Stamps, NDArray[np.float64]]:
    return _regular(len(rows)), np.stack([se3.validated(row.reshape(3, 4)) for row in rows])


def _regular(count: int) -> Stamps:
    """Times of scans that come without."""
    return np.arange(count, dtype=np.int64) * SCAN_PERIOD_NS


def _g2o(file: Path) -> list[se3.Matrix4]:
    """The poses of the vertices by their number: x, y, z and quaternion, or x, y and heading."""
    found: dict[int, se3.Matrix4] = {}
    for words in (line.split() for line in file.read_text(errors="replace").splitlines()):
        try:
            if words[:1] == ["VERTEX_SE3:QUAT"]:
                x, y, z, *quaternion = (float(word) for word in words[2:9])
                found[int(words[1])] = se3.from_quaternion(quaternion, (x, y, z))
            elif words[:1] == ["VERTEX_SE2"]:
                x, y, heading = (float(word) for word in words[2:5])
                found[int(words[1])] = se3.from_yaw(heading, (x, y, 0.0))
        except (ValueError, IndexError) as error:
            raise MalformedBody(f"a vertex of {file.name} cannot be read: {' '.join(words)[:80]!r}") from error
    return [found[number] for number in sorted(found)]


def _times_in_names(files: list[Path]) -> Stamps | None:
    """The times that the files are named by, nanoseconds; None where one is not."""
    times = [_time_in_name(file.stem) for file in files]
    found = [time for time in times if time is not None]
    return np.array(found, dtype=np.int64) if len(found) == len(files) else None


def _time_in_name(stem: str) -> int | None:
    """A smaller whole number is a number of the file."""
    if not stem.replace(".", "", 1).isdecimal() or ("." not in stem and len(stem) < MICROSECOND_DIGITS):
        return None
    return nanoseconds(stem)


def _pass_alike(named_ns: Stamps, stamps_ns: Stamps) -> bool:
    """Whether two clocks, as many times of each (n,), run along: apart by the same, up to half the time between two."""
    apart = named_ns - stamps_ns
    period = float(np.median(np.abs(np.diff(stamps_ns)))) if len(stamps_ns) > 1 else 0.0
    return bool(np.ptp(apart) <= 0.5 * period)
