"""KITTI-360: data_3d_raw/DRIVE/velodyne_points/data/*.bin, data_poses/DRIVE/*.txt, calibration/*.txt.

The devkit's conventions: calib_cam_to_velo.txt is T_velo_camera, calib_cam_to_pose.txt T_imu_camera of the unrectified
left camera; cam0_to_world.txt speaks of the rectified one, which `R_rect_00` of perspective.txt leads to. The world's z
axis points up. Poses exist only for scans during which the car moved.
"""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField, MalformedBody
from revisit.core.geometry import se3
from revisit.evaluation.datasets.kitti import read_velodyne
from revisit.evaluation.datasets.number_rows import keyed_matrix, read_rows
from revisit.evaluation.datasets.posed_clouds import PosedClouds, Stamps, posed

SCAN_PERIOD_NS = 100_000_000


def open_kitti360(folder: Path) -> PosedClouds:
    """A drive, given as its folder under data_3d_raw.

    Takes cam0_to_world.txt where it is there, else poses.txt. Raises FileNotFoundError for missing files, MalformedBody
    for unreadable ones, BadField where frames or times do not fit, BadTransform for bad poses.
    """
    root, drive = folder.resolve().parent.parent, folder.resolve().name
    frames, T_world_velo = _poses(root / "data_poses" / drive, root / "calibration")
    data = folder / "velodyne_points" / "data"
    files = [data / f"{frame:010d}.bin" for frame in frames]
    present = [index for index, file in enumerate(files) if file.exists()]
    if not present:
        raise FileNotFoundError(f"none of the scans with poses is in {data}")
    stamps = _stamps(folder / "velodyne_points" / "timestamps.txt", frames)
    poses = [T_world_velo[index] for index in present]
    return posed(drive, [files[index] for index in present], poses, stamps[present], read_velodyne)


def _poses(poses: Path, calibration: Path) -> tuple[NDArray[np.int64], list[se3.Matrix4]]:
    """Frame numbers and T_world_velo."""
    T_velo_camera = se3.validated(read_rows(calibration / "calib_cam_to_velo.txt", 12).reshape(3, 4))
    T_camera_velo = se3.inverse(T_velo_camera)
    if (poses / "cam0_to_world.txt").exists():
        rows = read_rows(poses / "cam0_to_world.txt", 17)
        T_rectified_velo = _rectification(calibration / "perspective.txt") @ T_camera_velo
        matrices = rows[:, 1:].reshape(-1, 4, 4)
    else:
        rows = read_rows(poses / "poses.txt", 13)
        T_rectified_velo = se3.validated(keyed_matrix(calibration / "calib_cam_to_pose.txt", "image_00", (3, 4)))
        T_rectified_velo = T_rectified_velo @ T_camera_velo
        matrices = rows[:, 1:].reshape(-1, 3, 4)
    return rows[:, 0].astype(np.int64), [se3.validated(matrix) @ T_rectified_velo for matrix in matrices]


def _rectification(file: Path) -> se3.Matrix4:
    """T_rectified_camera; the identity without perspective.txt."""
    if not file.exists():
        return np.eye(4)
    rotation = keyed_matrix(file, "R_rect_00", (3, 3))
    return se3.validated(np.column_stack([rotation, np.zeros(3)]))


def _stamps(file: Path, frames: NDArray[np.int64]) -> Stamps:
    """Nanoseconds since 1970 of the frames; 0.1 s apart without timestamps.txt."""
    if not file.exists():
        return np.asarray(frames * SCAN_PERIOD_NS, dtype=np.int64)
    lines = [line.strip() for line in file.read_text().splitlines() if line.strip()]
    if frames.max() >= len(lines):
        raise BadField(f"{file.name} has {len(lines)} lines, the poses name frame {frames.max()}", field=file.name)
    return np.array([_nanoseconds(lines[frame], file.name) for frame in frames], dtype=np.int64)


def _nanoseconds(text: str, name: str) -> int:
    """`2013-05-28 08:46:02.904616064` in nanoseconds since 1970."""
    whole, _, fraction = text.partition(".")
    try:
        moment = datetime.datetime.fromisoformat(whole).replace(tzinfo=datetime.UTC)
        return int(moment.timestamp()) * 10**9 + int(fraction.ljust(9, "0")[:9] or 0)
    except ValueError as error:
        raise MalformedBody(f"{name} holds {text!r}, which is no time") from error
