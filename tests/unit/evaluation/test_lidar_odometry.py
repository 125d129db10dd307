"""Recordings without poses: KISS-ICP makes them of the clouds, in folders and in bags."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.cli.ingest import Extent
from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.evaluation.datasets import KISS_ICP, WantedTopics, notes_of, open_recording, unposed_of
from revisit.evaluation.datasets.lidar_odometry import odometry_of
from revisit.formats import npy
from tests.support.bag_layouts import Layout

pytest.importorskip("kiss_icp", reason="in the extra `kiss-icp`")

WANTED = WantedTopics(odometry=KISS_ICP)
COUNT = 12


def world() -> np.ndarray:
    """A ground, and boxes of several sizes on it: (n, 3)."""
    random = np.random.default_rng(3)
    ground = np.column_stack([random.uniform(-40, 40, (12_000, 2)), np.zeros(12_000)])
    walls = []
    for _ in range(30):
        (x, y), (width, depth), height = random.uniform(-35, 35, 2), random.uniform(2, 6, 2), random.uniform(2, 8)
        along, up = random.uniform(-0.5, 0.5, 800), random.uniform(0, height, 800)
        walls.append(np.column_stack([x + width * along[:400], np.full(400, y), up[:400]]))
        walls.append(np.column_stack([np.full(400, x), y + depth * along[400:], up[400:]]))
    return np.concatenate([ground, *walls])


def pose(index: int) -> np.ndarray:
    """T_world_sensor: half a metre on and a degree round with each cloud, 1.5 m above the ground."""
    step = se3.exp([0.5, 0, 0, 0, 0, np.radians(1.0)])
    return se3.from_yaw(0.3, (0, 0, 1.5)) @ np.linalg.matrix_power(step, index)


def clouds(mounted: np.ndarray | None = None) -> list[np.ndarray]:
    seen, mounting = world(), np.eye(4) if mounted is None else mounted
    return [se3.apply(se3.inverse(pose(index) @ mounting), seen).astype(np.float32) for index in range(COUNT)]


def furthest_m(T_odom_sensor: np.ndarray, mounted: np.ndarray | None = None) -> float:
    """How far the motion since the first cloud is from the true one."""
    mounting = np.eye(4) if mounted is None else mounted
    apart = [
        se3.inverse(T_odom_sensor[0]) @ T_odom_sensor[index]
        @ se3.inverse(se3.inverse(pose(0) @ mounting) @ pose(index) @ mounting)
        for index in range(COUNT)
    ]  # fmt: skip
    return max(float(np.linalg.norm(one[:3, 3])) for one in apart)


@pytest.fixture
def folder(tmp_path):
    for index, cloud in enumerate(clouds()):
        (tmp_path / f"{index}.npy").write_bytes(npy.encode(cloud))
    return tmp_path


def test_the_motion_of_a_folder_of_clouds_is_found_and_its_quality_told(folder):
    recording = open_recording(folder, wanted=WANTED)
    assert len(recording) == COUNT
    assert furthest_m(np.stack([recording.pose(index) for index in range(COUNT)])) < 0.05
    (said,) = notes_of(recording)
    assert "poses by KISS-ICP from 12 clouds: 6 m, the longest step 0.50 m; 100 %" in said


def test_times_come_from_the_file_of_times_or_else_are_a_tenth_of_a_second_apart(folder):
    assert np.diff(open_recording(folder, wanted=WANTED).stamps_ns).tolist() == [100_000_000] * (COUNT - 1)
    (folder / "times.txt").write_text("".join(f"{0.25 * index}\n" for index in range(COUNT)))
    assert np.diff(open_recording(folder, wanted=WANTED).stamps_ns).tolist() == [250_000_000] * (COUNT - 1)


def test_a_sensor_that_is_mounted_aslant_is_levelled_by_the_ground():
    mounted = se3.exp([0, 0, 0, 0, np.radians(25.0), 0])
    found = odometry_of(lambda index: clouds(mounted)[index], COUNT)
    up_seen = found.T_odom_sensor[0][:3, :3] @ se3.inverse(pose(0) @ mounted)[:3, :3] @ [0, 0, 1]
    assert up_seen[2] > np.cos(np.radians(1.0))
    assert furthest_m(found.T_odom_sensor, mounted) < 0.05


def test_the_same_clouds_give_the_same_poses():
    seen = clouds()
    first, second = (odometry_of(seen.__getitem__, COUNT).T_odom_sensor for _ in range(2))
    assert np.array_equal(first, second)


def test_clouds_that_do_not_meet_are_warned_of():
    random = np.random.default_rng(0)
    strange = [random.uniform(-30, 30, (2000, 3)).astype(np.float32) for _ in range(4)]
    said = odometry_of(strange.__getitem__, 4).notes()
    assert any(note.startswith("warning: few points meet the cloud before") for note in said)


def test_a_bag_with_clouds_alone_is_read_with_the_poses_of_its_clouds(tmp_path):
    pytest.importorskip("rosbags", reason="in the extra `dev`: writes the bag")
    bag = Layout().raw("/points", "lidar").write2(tmp_path / "drive")
    told = []
    recording = open_recording(bag, wanted=WANTED, report=lambda *progress: told.append(progress))
    assert len(recording) == 8 and told[-1][1:] == (8, 8)
    said = " | ".join(notes_of(recording))
    assert "poses by KISS-ICP from 8 clouds" in said and "KISS-ICP has found out how lidar moved" in said


def test_only_the_clouds_up_to_a_limit_are_read_and_the_rest_goes_on_with_the_same_poses(folder):
    told = []
    few = open_recording(folder, wanted=WANTED, report=lambda *progress: told.append(progress), limit=4)
    assert (len(few), unposed_of(few), told[-1][1:]) == (4, COUNT - 4, (4, 4))
    every = open_recording(folder, wanted=WANTED)
    assert [few.pose(index).tolist() for index in range(4)] == [every.pose(index).tolist() for index in range(4)]
    assert few.stamps_ns.tolist() == every.stamps_ns[:4].tolist()
    # The session stays open: the rest of the recording is to come.
    assert not Extent(limit=4).finishes(few) and Extent(limit=4).left_out(few) == COUNT - 4
    assert Extent(limit=COUNT).finishes(open_recording(folder, wanted=WANTED, limit=COUNT))
    assert Extent().finishes(every)


def test_only_the_clouds_of_a_bag_up_to_a_limit_are_read(tmp_path):
    pytest.importorskip("rosbags", reason="in the extra `dev`: writes the bag")
    bag = Layout().raw("/points", "lidar").write2(tmp_path / "drive")
    told = []
    few = open_recording(bag, wanted=WANTED, report=lambda *progress: told.append(progress), limit=3)
    assert (len(few), unposed_of(few), told[-1][1:]) == (3, 5, (3, 3))
    assert few.stamps_ns.tolist() == open_recording(bag, wanted=WANTED).stamps_ns[:3].tolist()


def test_poses_that_are_given_and_poses_that_are_made_exclude_each_other(folder):
    (folder / "poses.txt").write_text("0 0 0 0 0 0 0 1\n")
    with pytest.raises(BadField, match="no others are taken"):
        open_recording(folder, wanted=WANTED, poses=folder / "poses.txt")


def test_without_kiss_icp_a_sentence_names_the_extra(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "kiss_icp.config", None)
    with pytest.raises(ImportError, match=r"pip install 'revisit-loops\[kiss-icp\]'"):
        open_recording(folder, wanted=WANTED)
    answer = CliRunner().invoke(app, ["ingest", str(folder), "--odometry", KISS_ICP])
    assert str(answer.exception) == "revisit: KISS-ICP is not installed: pip install 'revisit-loops[kiss-icp]'"
