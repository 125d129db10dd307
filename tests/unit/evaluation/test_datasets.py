"""KITTI folders: frames, round trip, damaged input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from revisit.core.errors import BadField, BadTransform, MalformedBody
from revisit.core.geometry import se3
from revisit.evaluation.datasets import KittiRecording, write_kitti
from revisit.evaluation.datasets.cloud_folder import open_cloud_folder
from revisit.formats import encode_npy


def cloud(seed: int, count: int = 150) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-20, 20, (count, 3)).astype(np.float32)


def written(folder: Path, count: int = 3) -> list[tuple[np.ndarray, np.ndarray, int]]:
    poses = [se3.exp((i, 2.0 * i, 0.1, 0.01, -0.02, 0.3 * i)) for i in range(count)]
    scans = [(cloud(i), pose, 123_456_789 + i * 10**9) for i, pose in enumerate(poses)]
    assert write_kitti(folder, scans) == count
    return scans


def test_a_written_drive_is_read_back_as_it_was(tmp_path: Path) -> None:
    scans = written(tmp_path / "drive")
    recording = KittiRecording(tmp_path / "drive")
    assert recording.name == "drive" and len(recording) == 3
    for index, (scan, (points, pose, stamp_ns)) in enumerate(zip(recording, scans, strict=True)):
        np.testing.assert_array_equal(scan.points, points)
        np.testing.assert_allclose(scan.T_odom_sensor, pose, atol=1e-8)
        np.testing.assert_allclose(recording.pose(index), pose, atol=1e-8)
        assert scan.stamp_ns == stamp_ns


def test_camera_poses_become_lidar_poses_with_z_up(tmp_path: Path) -> None:
    # KITTI's camera looks along z, x to the right, y down. One metre along camera z is one metre along LiDAR x.
    written(tmp_path, count=2)
    (tmp_path / "calib.txt").write_text("P0: 1 0 0 0\nTr: 0 -1 0 0.1 0 0 -1 0.2 1 0 0 0.3\n")
    (tmp_path / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 -0.5 0 0 1 1.0\n")
    recording = KittiRecording(tmp_path)
    np.testing.assert_allclose(recording.pose(0), np.eye(4), atol=1e-12)
    np.testing.assert_allclose(recording.pose(1)[:3, 3], [1.0, 0.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(recording.pose(1)[:3, :3], np.eye(3), atol=1e-12)


def test_without_times_and_calibration_scans_are_a_tenth_of_a_second_apart_and_poses_are_taken_as_they_are(
    tmp_path: Path,
) -> None:
    scans = written(tmp_path)
    (tmp_path / "times.txt").unlink()
    (tmp_path / "calib.txt").unlink()
    recording = KittiRecording(tmp_path)
    assert [scan.stamp_ns for scan in recording] == [0, 100_000_000, 200_000_000]
    np.testing.assert_allclose(recording.pose(2), scans[2][1], atol=1e-8)


def test_a_torn_scan_file_is_refused_when_it_is_read(tmp_path: Path) -> None:
    written(tmp_path)
    torn = tmp_path / "velodyne" / "000001.bin"
    torn.write_bytes(torn.read_bytes()[:-5])
    recording = KittiRecording(tmp_path)
    recording.scan(0)
    with pytest.raises(MalformedBody, match="no multiple of 16"):
        recording.scan(1)


@pytest.mark.parametrize(
    ("file", "text", "error"),
    [
        ("poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", BadField),
        ("poses.txt", "1 0 0\n1 0 0\n1 0 0\n", MalformedBody),
        ("poses.txt", "one\ntwo\nthree\n", MalformedBody),
        ("poses.txt", "2 0 0 0 0 2 0 0 0 0 2 0\n" * 3, BadTransform),
        ("times.txt", "0.0\n0.1\n", BadField),
        ("calib.txt", "Tr: 1 0 0\n", MalformedBody),
        ("times.txt", "0.0\nnan\n0.2\n", MalformedBody),
        ("calib.txt", "P0: 1 0 0 0\n", MalformedBody),
        ("calib.txt", "Tr: a b c\n", MalformedBody),
        ("calib.txt", "Tr: \udcff\n", MalformedBody),
    ],
)
def test_damaged_text_files_are_refused_with_a_reason(
    tmp_path: Path, file: str, text: str, error: type[Exception]
) -> None:
    written(tmp_path)
    (tmp_path / file).write_text(text, errors="surrogateescape")
    with pytest.raises(error):
        KittiRecording(tmp_path)


def test_a_folder_without_scans_is_not_found(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        KittiRecording(tmp_path)


def test_clouds_with_the_vertices_of_a_pose_graph_are_a_recording(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(200, 3)).astype(np.float32)
    for number in range(3):
        (tmp_path / f"{number:03d}.npy").write_bytes(encode_npy(points + number))
    lines = [f"VERTEX_SE3:QUAT {n} {4 * n} 1 0 0 0 0.6 0.8" for n in (2, 0, 1)]
    (tmp_path / "graph.g2o").write_text("\n".join([*lines, "FIX 0", "EDGE_SE3:QUAT 0 1 not read"]))
    recording = open_cloud_folder(tmp_path)
    scans = [recording.scan(n) for n in range(len(recording))]
    assert [scan.T_odom_sensor[0, 3] for scan in scans] == [0.0, 4.0, 8.0]
    np.testing.assert_allclose(scans[1].T_odom_sensor, se3.from_yaw(2 * np.arcsin(0.6), (4.0, 0.0, 0.0)), atol=1e-12)
    (tmp_path / "graph.g2o").write_text("\n".join(lines[:2]))
    with pytest.raises(BadField, match="2 vertices for 3 clouds"):
        open_cloud_folder(tmp_path)
    (tmp_path / "graph.g2o").write_text("VERTEX_SE3:QUAT 0 1 2\n")
    with pytest.raises(MalformedBody, match="cannot be read"):
        open_cloud_folder(tmp_path)
