"""Published folder layouts in miniature: frames, clocks, extrinsics and damaged input."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from revisit.core.errors import BadField, BadTransform, MalformedBody
from revisit.core.geometry import se3
from revisit.evaluation.datasets import (
    notes_of,
    open_cloud_folder,
    open_kitti360,
    open_mulran,
    open_nclt,
    open_recording,
)
from revisit.evaluation.datasets.number_rows import nanoseconds
from revisit.evaluation.datasets.posed_clouds import StampedPoses
from revisit.formats import pcd, ply

COUNT = 150


def cloud(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-20, 20, (COUNT, 3)).astype(np.float32)


def write_velodyne(file: Path, points: np.ndarray) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    np.column_stack([points, np.zeros(len(points))]).astype("<f4").tofile(file)


def row(numbers: np.ndarray, separator: str = " ") -> str:
    return separator.join(repr(float(value)) for value in np.ravel(numbers))


# --- KITTI-360 ---------------------------------------------------------------------------------------------------

# The camera looks along the car's x axis: camera x right, y down, z ahead.
T_VELO_CAMERA = np.array([[0.0, 0, 1, 0.3], [-1, 0, 0, 0.1], [0, -1, 0, -0.2], [0, 0, 0, 1]])
T_IMU_CAMERA = se3.from_yaw(0.1, (1.0, 0.2, 0.4)) @ T_VELO_CAMERA
T_RECTIFIED_CAMERA = se3.exp((0, 0, 0, 0.01, -0.02, 0.005))


def kitti360(root: Path, *, with_camera_poses: bool) -> tuple[Path, list[np.ndarray]]:
    """Frames 1 and 3 have poses, 0 and 2 do not: (folder, T_world_velo of the two)."""
    drive = "2013_05_28_drive_0000_sync"
    folder, calibration, poses = root / "data_3d_raw" / drive, root / "calibration", root / "data_poses" / drive
    for frame in range(4):
        write_velodyne(folder / "velodyne_points" / "data" / f"{frame:010d}.bin", cloud(frame))
    (folder / "velodyne_points" / "timestamps.txt").write_text(
        "".join(f"2013-05-28 08:46:0{frame}.904616064\n" for frame in range(4))
    )
    calibration.mkdir(parents=True)
    poses.mkdir(parents=True)
    (calibration / "calib_cam_to_velo.txt").write_text(row(T_VELO_CAMERA[:3]) + "\n")
    (calibration / "calib_cam_to_pose.txt").write_text(f"image_00: {row(T_IMU_CAMERA[:3])}\nimage_01: 1 2 3\n")
    (calibration / "perspective.txt").write_text(
        f"calib_time: 01-Jan-2013\nR_rect_00: {row(T_RECTIFIED_CAMERA[:3, :3])}\nP_rect_00: 1 0\n"
    )
    velo = [se3.from_yaw(0.5 * frame, (1000.0 + frame, 3000.0, 110.0)) for frame in (1, 3)]
    imu = [T @ T_VELO_CAMERA @ se3.inverse(T_IMU_CAMERA) for T in velo]
    (poses / "poses.txt").write_text("".join(f"{f} {row(T[:3])}\n" for f, T in zip((1, 3), imu, strict=True)))
    if with_camera_poses:
        rectified = [T @ T_VELO_CAMERA @ se3.inverse(T_RECTIFIED_CAMERA) for T in velo]
        lines = [f"{f} {row(T)}\n" for f, T in zip((1, 3), rectified, strict=True)]
        (poses / "cam0_to_world.txt").write_text("".join(lines))
    return folder, velo


@pytest.mark.parametrize("with_camera_poses", [True, False])
def test_kitti_360_gives_the_poses_of_the_velodyne_for_the_frames_that_have_poses(
    tmp_path: Path, with_camera_poses: bool
) -> None:
    folder, velo = kitti360(tmp_path, with_camera_poses=with_camera_poses)
    recording = open_kitti360(folder)
    assert recording.name == "2013_05_28_drive_0000_sync" and len(recording) == 2
    np.testing.assert_allclose(recording.pose(0)[:3, :3], velo[0][:3, :3], atol=1e-9)
    np.testing.assert_allclose(recording.pose(1)[:3, 3], [2.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(recording.pose(1)[:3, :3], velo[1][:3, :3], atol=1e-9)
    np.testing.assert_array_equal(recording.scan(1).points, cloud(3))
    # 2013-05-28 08:46:03 UTC is 1369730763 s after 1970.
    assert recording.scan(1).stamp_ns == 1_369_730_763_904_616_064


def test_kitti_360_poses_beyond_the_time_stamps_are_refused(tmp_path: Path) -> None:
    folder, _ = kitti360(tmp_path, with_camera_poses=False)
    (folder / "velodyne_points" / "timestamps.txt").write_text("2013-05-28 08:46:00.1\n")
    with pytest.raises(BadField, match="frame 3"):
        open_kitti360(folder)


# --- MulRan ------------------------------------------------------------------------------------------------------

START_NS = 1_561_000_444_390_857_630


def mulran(folder: Path) -> Path:
    """The car drives 1 m east a second; poses at 0, 1 and 2 s, scans at 0.25, 1.5 and 9 s."""
    for offset_ns in (250_000_000, 1_500_000_000, 9_000_000_000):
        write_velodyne(folder / "Ouster" / f"{START_NS + offset_ns}.bin", cloud(offset_ns % 97))
    poses = [se3.from_yaw(0.0, (353_000.0 + second, 4_026_000.0, 20.0)) for second in range(3)]
    lines = [f"{START_NS + second * 10**9},{row(T[:3], ',')}\n" for second, T in enumerate(poses)]
    (folder / "global_pose.csv").write_text("".join([*lines, lines[-1]]))
    return folder


def test_mulran_poses_are_interpolated_at_the_scans_and_carried_to_the_ouster(tmp_path: Path) -> None:
    recording = open_mulran(mulran(tmp_path / "DCC01"))
    assert recording.name == "DCC01" and len(recording) == 2
    assert recording.scan(0).stamp_ns == START_NS + 250_000_000
    np.testing.assert_allclose(recording.pose(0)[:3, 3], 0.0, atol=1e-12)
    np.testing.assert_allclose(recording.pose(1)[:3, 3], [1.25, 0.0, 0.0], atol=1e-7)
    # The Ouster looks backwards: its x axis points west while the car drives east, its z axis up.
    np.testing.assert_allclose(recording.pose(0)[:3, 0], [-0.99998295, 0.0058398386, 0.0], atol=1e-5)
    np.testing.assert_allclose(recording.pose(0)[:3, 2], [0.0, 0.0, 1.0], atol=1e-5)


def test_two_sessions_of_one_map_are_put_into_one_world(tmp_path: Path) -> None:
    first, second = (mulran(tmp_path / name) for name in ("DCC01", "DCC02"))
    shifted = (second / "global_pose.csv").read_text().replace("4026000.0", "4026007.0")
    (second / "global_pose.csv").write_text(shifted)
    known, asking = open_mulran(first), open_mulran(second)
    np.testing.assert_allclose(asking.pose(0)[:3, 3], 0.0, atol=1e-12)
    np.testing.assert_allclose(asking.beside(known).pose(0)[:3, 3], [0.0, 7.0, 0.0], atol=1e-6)


def test_a_mulran_scan_that_is_not_named_by_its_time_is_refused(tmp_path: Path) -> None:
    folder = mulran(tmp_path)
    write_velodyne(folder / "Ouster" / "scan.bin", cloud(0))
    with pytest.raises(BadField, match=r"scan\.bin"):
        open_mulran(folder)


# --- NCLT --------------------------------------------------------------------------------------------------------

START_US = 1_326_030_975_726_043


def nclt(folder: Path) -> Path:
    """The body (z down) turns right by 0.2 rad a second while it climbs 1 m; one scan half a second on."""
    (folder / "velodyne_sync").mkdir(parents=True)
    hits = [struct.pack("<HHHBB", 20_000 + 200 * i, 20_400 + 200 * (i % 5), 40_000, 7, 3) for i in range(COUNT)]
    (folder / "velodyne_sync" / f"{START_US + 500_000}.bin").write_bytes(b"".join(hits))
    lines = [
        f"{START_US - 1},nan,nan,nan,nan,nan,nan",
        f"{START_US},5,2,-3,0,0,0.0",
        f"{START_US + 10**6},5,2,-4,0,0,0.2",
    ]
    (folder / f"groundtruth_{folder.name}.csv").write_text("\n".join(lines) + "\n")
    return folder


def test_nclt_hits_are_unsigned_half_centimetres_from_minus_a_hundred_and_z_is_turned_up(tmp_path: Path) -> None:
    scan = open_nclt(nclt(tmp_path / "2012-01-08")).scan(0)
    # 20,000 units are 0 m, 20,400 are 2 m to the right, 40,000 are 100 m down: beyond what 15 bits would hold.
    np.testing.assert_allclose(scan.points[0], [0.0, -2.0, -100.0], atol=1e-4)
    np.testing.assert_allclose(scan.points[1], [1.0, -3.0, -100.0], atol=1e-4)
    assert scan.stamp_ns == (START_US + 500_000) * 1000


def test_nclt_poses_are_turned_to_z_up_and_interpolated(tmp_path: Path) -> None:
    folder = nclt(tmp_path / "2012-01-08")
    pose = open_nclt(folder).pose(0)
    # A right turn is a negative yaw once z points up.
    assert se3.yaw(pose) == pytest.approx(-0.1, abs=1e-9)
    np.testing.assert_allclose(pose[:3, 2], [0.0, 0.0, 1.0], atol=1e-9)


def test_nclt_ground_truth_may_lie_in_its_own_folder(tmp_path: Path) -> None:
    folder = nclt(tmp_path / "2012-01-08")
    (tmp_path / "ground_truth").mkdir()
    (folder / "groundtruth_2012-01-08.csv").rename(tmp_path / "ground_truth" / "groundtruth_2012-01-08.csv")
    assert len(open_nclt(folder)) == 1


def test_a_torn_nclt_scan_is_refused_when_it_is_read(tmp_path: Path) -> None:
    folder = nclt(tmp_path / "2012-01-08")
    file = next((folder / "velodyne_sync").iterdir())
    file.write_bytes(file.read_bytes()[:-3])
    with pytest.raises(MalformedBody, match="no multiple of 8"):
        open_nclt(folder).scan(0)


# --- any folder of clouds ----------------------------------------------------------------------------------------


def test_as_many_tum_rows_as_clouds_belong_to_them_one_by_one(tmp_path: Path) -> None:
    for index, encode in enumerate((pcd.encode, ply.encode)):
        (tmp_path / f"{index}.{'pcd' if index == 0 else 'ply'}").write_bytes(encode(cloud(index)))
    half = np.sqrt(0.5)
    (tmp_path / "poses.txt").write_text(
        f"# stamp x y z qx qy qz qw\n10.000000001 1 2 3 0 0 0 1\n11.5 2 2 3 0 0 {half} {half}\n"
    )
    recording = open_cloud_folder(tmp_path)
    assert [scan.stamp_ns for scan in recording] == [10_000_000_001, 11_500_000_000]
    np.testing.assert_array_equal(recording.scan(1).points, cloud(1))
    np.testing.assert_allclose(recording.pose(1), se3.from_yaw(np.pi / 2, (1.0, 0.0, 0.0)), atol=1e-9)
    assert "the first pose, at 1.000 2.000 3.000, is the origin" in notes_of(recording)[0]


def test_kitti_rows_are_taken_for_clouds_in_a_folder_of_their_own(tmp_path: Path) -> None:
    (tmp_path / "clouds").mkdir()
    for index in range(2):
        (tmp_path / "clouds" / f"{index:04d}.pcd").write_bytes(pcd.encode(cloud(index)))
    (tmp_path / "poses.txt").write_text("".join(row(se3.from_yaw(0.0, (4.0 * i, 0, 0))[:3]) + "\n" for i in range(2)))
    recording = open_recording(tmp_path, "clouds")
    np.testing.assert_allclose(recording.pose(1)[:3, 3], [4.0, 0.0, 0.0], atol=1e-9)


def test_clouds_named_by_their_time_find_their_place_between_the_poses(tmp_path: Path) -> None:
    for name in ("10.500000", "12.250000", "99.000000"):
        (tmp_path / f"{name}.pcd").write_bytes(pcd.encode(cloud(0)))
    rows = [f"{second} {second} 0 0 0 0 0 1" for second in (10, 11, 12, 13)]
    (tmp_path / "trajectory.tum").write_text("\n".join(rows))
    recording = open_cloud_folder(tmp_path)
    assert len(recording) == 2
    np.testing.assert_allclose(recording.pose(1)[:3, 3], [1.75, 0.0, 0.0], atol=1e-9)


def test_rows_at_other_times_than_the_clouds_are_named_by_are_not_taken_one_by_one(tmp_path: Path) -> None:
    for tenth in range(4):
        (tmp_path / f"{10**18 + tenth * 10**8}.pcd").write_bytes(pcd.encode(cloud(tenth)))
    rows = [f"{10**9 + 0.2 * number:.1f} {number} 0 0 0 0 0 1" for number in range(4)]
    (tmp_path / "poses.tum").write_text("\n".join(rows))
    recording = open_cloud_folder(tmp_path)
    np.testing.assert_allclose([recording.pose(index)[0, 3] for index in range(4)], [0.0, 0.5, 1.0, 1.5], atol=1e-6)


def test_rows_of_another_clock_that_runs_along_are_taken_one_by_one(tmp_path: Path) -> None:
    for tenth in range(3):
        (tmp_path / f"{10**18 + tenth * 10**8 + 7 * tenth}.pcd").write_bytes(pcd.encode(cloud(tenth)))
    (tmp_path / "poses.tum").write_text("\n".join(f"0.{tenth} {tenth} 0 0 0 0 0 1" for tenth in range(3)))
    recording = open_cloud_folder(tmp_path)
    assert recording.stamps_ns.tolist() == [0, 10**8, 2 * 10**8] and notes_of(recording) == ()


@pytest.mark.parametrize(
    ("time", "stamp_ns"),
    [("1403636579.763555584", 1403636579763555584), ("1403636579763555584", 1403636579763555584),
     ("1403636579763555", 1403636579763555000), ("1.4e9", 1400000000000000000), ("-0.5", -500000000)],
)  # fmt: skip
def test_a_whole_number_too_long_for_seconds_is_one_of_a_smaller_unit(time: str, stamp_ns: int) -> None:
    assert nanoseconds(time) == stamp_ns


@pytest.mark.parametrize("time", ["inf", "nan", "1e12", "99999999999.5", "9" * 19, "now", ""])
def test_what_is_no_time_is_refused(tmp_path: Path, time: str) -> None:
    with pytest.raises(MalformedBody, match="no time"):
        nanoseconds(time)


@pytest.mark.parametrize(
    "names",
    [("2", "10"), ("scan_9", "scan_10"), ("12.45", "12.5"), ("7", "000008"), ("part_1.9", "part_1.10"),
     ("cloud_1700000000.15", "cloud_1700000000.2")],
)  # fmt: skip
def test_clouds_are_in_the_order_of_the_numbers_in_their_names(tmp_path: Path, names: tuple[str, str]) -> None:
    for index, name in enumerate(names):
        (tmp_path / f"{name}.pcd").write_bytes(pcd.encode(cloud(index)))
    (tmp_path / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 9 0 1 0 0 0 0 1 0\n")
    recording = open_cloud_folder(tmp_path)
    for index in range(2):
        np.testing.assert_allclose(recording.scan(index).points, cloud(index), atol=1e-3)


def test_poses_are_not_made_up_for_a_pause_in_which_the_body_moved() -> None:
    seconds = np.array([0, 1, 2, 3, 13, 14, 34, 35], dtype=np.int64) * 10**9
    way = [0.0, 1.0, 2.0, 3.0, 13.0, 14.0, 14.0, 15.0]  # on while nothing is told until 13 s, at rest until 34 s
    poses = StampedPoses(seconds, np.stack([se3.from_yaw(0.0, (x, 0.0, 0.0)) for x in way]))
    asked = np.array([-1, 0, 3, 8, 13, 20, 35, 36], dtype=np.int64) * 10**9
    assert poses.covered(asked).tolist() == [False, True, True, False, True, True, True, False]


@pytest.mark.parametrize(
    ("file", "advice"),
    [
        ("part1/drive/drive_0.mcap", "there are bags in .*drive: name one of them"),
        ("drive.bag.active", "rename it to .bag"),
        ("drive_0.db3.gz", "unpack it first"),
    ],
)
def test_a_folder_with_bags_out_of_sight_is_refused_with_what_to_do(tmp_path: Path, file: str, advice: str) -> None:
    (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / file).touch()
    with pytest.raises(FileNotFoundError, match=advice):
        open_recording(tmp_path)


@pytest.mark.parametrize(
    ("poses", "error"),
    [
        ("1 2 3\n", MalformedBody),
        ("", MalformedBody),
        ("0 0 0 0 0 0 0 5\n", BadTransform),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n", BadField),
    ],
)
def test_trajectories_that_do_not_fit_are_refused(tmp_path: Path, poses: str, error: type[Exception]) -> None:
    for index in range(2):
        (tmp_path / f"{index}.pcd").write_bytes(pcd.encode(cloud(index)))
    (tmp_path / "poses.txt").write_text(poses)
    with pytest.raises(error):
        open_cloud_folder(tmp_path)


@pytest.mark.parametrize(
    ("layout", "file"),
    [
        ("mulran", "global_pose.csv"),
        ("kitti360", "calib_cam_to_velo.txt"),
        ("nclt", "groundtruth"),
        ("kitti", "velodyne"),
    ],
)
def test_a_layout_without_one_of_its_files_is_refused_by_the_name_of_the_file(
    tmp_path: Path, layout: str, file: str
) -> None:
    with pytest.raises(FileNotFoundError, match=file) as refused:
        open_recording(tmp_path, layout)
    assert "Errno" not in str(refused.value)


def test_an_unknown_format_is_refused_with_those_that_are_known(tmp_path: Path) -> None:
    with pytest.raises(BadField, match="kitti360, mulran, nclt, clouds, rosbag2"):
        open_recording(tmp_path, "bag")
