"""KITTI odometry layout: velodyne/*.bin, poses.txt in the camera frame, calib.txt with `Tr`, times.txt."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField, MalformedBody
from revisit.core.geometry import se3
from revisit.core.point_columns import USUAL
from revisit.core.scan import Points, Scan
from revisit.evaluation.datasets.number_rows import keyed_matrix, read_rows, read_times, read_words
from revisit.evaluation.datasets.posed_clouds import in_number_order
from revisit.formats import DecodedCloud

SCAN_PERIOD_S = 0.1
_BYTES_PER_POINT = 16


class KittiRecording:
    """A KITTI odometry folder, scans read when asked for.

    poses.txt holds T_world_camera, calib.txt `Tr` = T_camera_lidar; the poses given out are
    inverse(Tr) @ P @ Tr, the LiDAR's pose in the LiDAR frame of the first scan, so that z is up. Without calib.txt, or
    with an identity Tr, poses.txt is taken as LiDAR poses. Without times.txt scans are 0.1 s apart.
    """

    def __init__(self, folder: Path | str) -> None:
        """Reads poses, calibration and times.

        Raises FileNotFoundError without scans or poses, MalformedBody for unreadable text, BadField where the numbers
        of scans, poses and times differ, BadTransform for bad poses.
        """
        self._folder = Path(folder)
        self._files = in_number_order((self._folder / "velodyne").glob("*.bin"))
        if not self._files:
            raise FileNotFoundError(f"no scans in {self._folder / 'velodyne'}")
        T_camera_lidar = _calibration(self._folder / "calib.txt")
        cameras = read_rows(self._folder / "poses.txt", 12).reshape(-1, 3, 4)
        self._check_count("poses.txt", len(cameras))
        T_lidar_camera = se3.inverse(T_camera_lidar)
        self._poses = [T_lidar_camera @ se3.validated(camera) @ T_camera_lidar for camera in cameras]
        self._stamps_ns = self._times()

    @property
    def name(self) -> str:
        """The folder's name."""
        return self._folder.resolve().name

    @property
    def files(self) -> Sequence[Path]:
        """The file of each scan."""
        return self._files

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """When each scan was taken (n,), nanoseconds."""
        return self._stamps_ns

    def __len__(self) -> int:
        return len(self._files)

    def pose(self, index: int) -> se3.Matrix4:
        """T_world_lidar of a scan, z up."""
        return self._poses[index]

    def scan(self, index: int) -> Scan:
        """The scan with that index. Raises MalformedBody for a damaged file and as `Scan.validated` does."""
        cloud = read_velodyne(self._files[index])
        return Scan.validated(cloud.points, self._poses[index], int(self._stamps_ns[index]), cloud.columns)

    def __iter__(self) -> Iterator[Scan]:
        return (self.scan(index) for index in range(len(self)))

    def _times(self) -> NDArray[np.int64]:
        file = self._folder / "times.txt"
        if not file.exists():
            return np.round(np.arange(len(self._files)) * SCAN_PERIOD_S * 1e9).astype(np.int64)
        stamps_ns = read_times(file)
        self._check_count("times.txt", len(stamps_ns))
        return stamps_ns

    def _check_count(self, file: str, count: int) -> None:
        if count != len(self._files):
            raise BadField(f"{file} has {count} rows for {len(self._files)} scans", field=file)


def read_velodyne(file: Path, _wanted: Collection[str] = USUAL) -> DecodedCloud:
    """The points of a .bin file of float32 x, y, z, reflectance (the only column). Raises
    MalformedBody for a torn file.
    """
    raw = file.read_bytes()
    if len(raw) % _BYTES_PER_POINT:
        rows = next((f": rows of {count} numbers?" for count in (3, 5) if len(raw) % (4 * count) == 0), "")
        raise MalformedBody(f"{file.name} holds {len(raw)} bytes, which is no multiple of {_BYTES_PER_POINT}{rows}")
    return DecodedCloud.of_table(np.frombuffer(raw, dtype="<f4").reshape(-1, 4))


def write_kitti(folder: Path | str, scans: Iterable[tuple[Points, se3.Matrix4, int]]) -> int:
    """Write scans (points (n, 3), T_world_sensor, stamp_ns) in KITTI layout with an identity Tr; returns their number.

    Times are stored with nanoseconds and poses with nanometres, so reading gives the same values.
    """
    target = Path(folder)
    (target / "velodyne").mkdir(parents=True, exist_ok=True)
    poses, times = [], []
    for index, (points, T_world_sensor, stamp_ns) in enumerate(scans):
        rows = np.zeros((len(points), 4), dtype="<f4")
        rows[:, :3] = points
        rows.tofile(target / "velodyne" / f"{index:06d}.bin")
        poses.append(" ".join(f"{value:.9f}" for value in T_world_sensor[:3].ravel()))
        times.append(f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}")
    (target / "poses.txt").write_text("\n".join(poses) + "\n")
    (target / "times.txt").write_text("\n".join(times) + "\n")
    (target / "calib.txt").write_text("Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n")
    return len(poses)


def _calibration(file: Path) -> se3.Matrix4:
    """T_camera_lidar of calib.txt (`Tr:` or `Tr_velo_cam:`), the identity without the file."""
    if not file.exists():
        return np.eye(4)
    named = {words[0].rstrip(":") for words in read_words(file)}
    key = next((key for key in ("Tr_velo_cam", "Tr_velo_to_cam") if key in named), "Tr")
    return se3.validated(keyed_matrix(file, key, (3, 4)))
