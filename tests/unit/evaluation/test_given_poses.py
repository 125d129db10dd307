"""A folder of clouds takes its poses from a file that is named, or that an odometry has left beside it."""

from __future__ import annotations

import pytest

from revisit.core.errors import BadField
from revisit.evaluation.datasets import open_recording
from revisit.formats import encode_npy
from tests.support.service_world import cloud_points

TUM = "".join(f"{0.1 * n:.1f} {n}.0 0 0 0 0 0 1\n" for n in range(3))
KITTI = "".join(f"1 0 0 {n}.0 0 1 0 0 0 0 1 0\n" for n in range(3))


@pytest.fixture
def clouds(tmp_path):
    folder = tmp_path / "clouds"
    folder.mkdir()
    for number in range(3):
        (folder / f"{number:06d}.npy").write_bytes(encode_npy(cloud_points(number, 50)))
    return tmp_path


def positions(recording):
    return [float(recording.pose(index)[0, 3]) for index in range(len(recording))]


@pytest.mark.parametrize("text", [TUM, KITTI])
def test_poses_may_lie_anywhere_and_are_named(clouds, tmp_path_factory, text):
    file = tmp_path_factory.mktemp("elsewhere") / "odometry.out"
    file.write_text(text)
    assert positions(open_recording(clouds, poses=file)) == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("results/latest/clouds_poses_tum.txt", TUM),
        ("results/latest/clouds_tum.txt", TUM),
        ("results/latest/clouds_poses_kitti.txt", KITTI),
        ("odom_lidar.txt", TUM),
        ("traj_lidar.txt", TUM),
    ],
)
def test_files_of_kiss_icp_and_of_glim_are_found(clouds, name, text):
    (clouds / name).parent.mkdir(parents=True, exist_ok=True)
    (clouds / name).write_text(text)
    assert positions(open_recording(clouds)) == [0.0, 1.0, 2.0]


def test_clouds_without_odometry_are_refused_with_what_makes_it(clouds):
    with pytest.raises(FileNotFoundError) as refused:
        open_recording(clouds)
    told = str(refused.value)
    assert "--poses FILE" in told and "--odometry kiss-icp" in told and "revisit-loops[kiss-icp]" in told


def test_a_bag_takes_no_file_of_poses(tmp_path):
    (tmp_path / "drive.mcap").write_bytes(b"")
    with pytest.raises(BadField, match="--poses"):
        open_recording(tmp_path / "drive.mcap", poses=tmp_path / "poses.txt")
