"""Bags of several robots: the clouds of one are never paired with the poses or the transforms of another."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.evaluation.datasets import WantedTopics, notes_of, open_bag
from revisit.evaluation.datasets.namespaces import alike, namespace, of_another_robot, shared, twins
from tests.support.bag_layouts import MOUNTED, START_NS, Layout, body_at, deviation

pytest.importorskip("rosbags", reason="in the extra `dev`: writes the bags")

OFTEN = [START_NS - 37_000_000 + 20_000_000 * index for index in range(42)]


def elsewhere(stamp_ns: int) -> np.ndarray:
    """Where another robot is."""
    return se3.from_yaw(2.0, (7.0, 3.0, 0.0)) @ body_at(stamp_ns) @ se3.from_yaw(0.0, (-4.0 * stamp_ns % 5, 0.0, 0.0))


def odometries() -> Layout:
    """That of the other robot has more samples, and covers as many clouds."""
    layout = Layout().raw("/robot1/points", "velodyne", MOUNTED).odometry("/robot1/odom", "odom", "base_link")
    layout.odometry("/robot2/odom", "odom", "base_link", elsewhere, OFTEN)
    return layout.transform("base_link", "velodyne", MOUNTED, moving=False)


def both_robots() -> Layout:
    return odometries().raw("/robot2/points", "velodyne")


def said(recording) -> str:
    return " | ".join(notes_of(recording))


@pytest.mark.parametrize(
    ("layout", "topic"), [(odometries, None), (odometries, "/robot1/points"), (both_robots, "/robot1/points")]
)
def test_clouds_get_the_odometry_of_their_namespace(tmp_path: Path, layout, topic: str | None) -> None:
    recording = open_bag(layout().write2(tmp_path / "drive"), WantedTopics(topic))
    assert "poses of /robot1/odom" in said(recording)
    assert deviation(recording) < 1e-4


def test_of_two_robots_one_is_read_and_the_other_one_is_named(tmp_path: Path) -> None:
    told = said(open_bag(both_robots().write2(tmp_path / "drive")))
    assert "clouds of /robot2/points" in told and "poses of /robot2/odom" in told
    assert "not used: /robot1/points; --topic chooses" in told


def test_an_odometry_that_is_named_is_taken_whatever_its_namespace(tmp_path: Path) -> None:
    wanted = WantedTopics("/robot1/points", "/robot2/odom")
    recording = open_bag(both_robots().write2(tmp_path / "drive"), wanted)
    assert "poses of /robot2/odom" in said(recording) and "warning" not in said(recording)


def test_poses_of_a_robot_whose_clouds_are_there_too_are_doubted(tmp_path: Path) -> None:
    layout = both_robots()
    layout.rows = [row for row in layout.rows if row[1] != "/robot2/odom"]
    bag = layout.write2(tmp_path / "drive")
    assert "clouds of /robot1/points" in said(open_bag(bag))
    told = said(open_bag(bag, WantedTopics("/robot2/points")))
    assert "warning: /robot1/odom may be of the robot of /robot1/points, not of that of /robot2/points" in told


def test_a_robot_without_a_namespace_beside_one_with_a_namespace_keeps_its_own_odometry(tmp_path: Path) -> None:
    layout = Layout().raw("/points", "base_link").odometry("/odom", "odom", "base_link")
    layout.raw("/robot2/points", "base_link").odometry("/robot2/odom", "odom", "base_link", elsewhere, OFTEN)
    recording = open_bag(layout.write2(tmp_path / "drive"), WantedTopics("/points"))
    assert "poses of /odom" in said(recording) and "warning" not in said(recording)
    assert deviation(recording) < 1e-4


def test_odometries_that_nothing_tells_apart_are_doubted(tmp_path: Path) -> None:
    layout = Layout().raw("/points", "base_link").odometry("/a/odom", "odom", "base_link")
    bag = layout.odometry("/b/odom", "odom", "base_link", elsewhere).write2(tmp_path / "drive")
    assert "warning: /b/odom would fit as well as /a/odom" in said(open_bag(bag))
    assert "warning" not in said(open_bag(bag, WantedTopics(odometry="/a/odom")))


@pytest.mark.parametrize("static", ["", "/robot1"])
@pytest.mark.parametrize("topic", ["/robot1/points", "/robot1/lidar/points"])
def test_transforms_are_kept_by_namespace(tmp_path: Path, static: str, topic: str) -> None:
    layout = Layout().raw(topic, "velodyne", MOUNTED)
    layout.transform("odom", "base_link", body_at, moving=True, namespace="/robot1")
    layout.transform("odom", "base_link", elsewhere, moving=True, namespace="/robot2")
    layout.transform("base_link", "velodyne", MOUNTED, moving=False, namespace=static)
    layout.transform("base_link", "velodyne", np.eye(4), moving=False, namespace="/robot2")
    layout.rows = [(at + (topic == "/robot1/tf"), topic, *rest) for at, topic, *rest in layout.rows]
    recording = open_bag(layout.write2(tmp_path / "drive"))
    assert deviation(recording) < 1e-4
    assert "poses by the transforms of /robot1/tf" in said(recording)
    assert "not used: transforms of /robot2/tf, /robot2/tf_static" in said(recording)


def test_the_transforms_of_the_one_robot_there_is_hold_for_clouds_outside_of_its_namespace(tmp_path: Path) -> None:
    layout = Layout().raw("/velodyne_points", "velodyne", MOUNTED)
    layout.transform("odom", "base_link", body_at, moving=True, namespace="/husky")
    layout.transform("base_link", "velodyne", MOUNTED, moving=False, namespace="/husky")
    assert deviation(open_bag(layout.write2(tmp_path / "drive"))) < 1e-4


def test_transforms_of_another_robot_do_not_tell_where_clouds_are(tmp_path: Path) -> None:
    layout = both_robots()
    layout.rows = [row for row in layout.rows if row[1] not in ("/tf_static", "/robot2/odom")]
    layout.transform("base_link", "velodyne", np.eye(4), moving=False, namespace="/robot2")
    layout.transform("odom", "base_link", elsewhere, moving=True, namespace="/robot2")
    told = said(open_bag(layout.write2(tmp_path / "drive"), WantedTopics("/robot1/points")))
    assert "poses of /robot1/odom" in told
    assert "warning: nothing tells where velodyne is in base_link" in told


def test_an_odometry_with_a_namespace_of_its_own_is_not_of_another_robot() -> None:
    sources, clouds = ["/odom", "/lio_sam/mapping/odometry"], ["/points_raw", "/lio_sam/mapping/cloud_registered"]
    assert not of_another_robot("/points_raw", "/lio_sam/mapping/odometry", sources, clouds)
    assert not of_another_robot("/husky/points", "/kiss/odometry", ["/husky/odom", "/kiss/odometry"], ["/husky/points"])
    assert of_another_robot("/a/points", "/b/odom", ["/a/odom", "/b/odom"], ["/a/points"])
    assert of_another_robot("/a/points", "/b/slam/pose", ["/a/odom", "/b/slam/pose"], ["/a/points", "/b/points"])


def test_namespaces_are_compared_by_whole_segments() -> None:
    assert namespace("/robot1/lidar/points") == ("robot1", "lidar") and namespace("/points") == ()
    assert shared("/robot1/points", "/robot1/odom") == 1 and shared("/robot1/points", "/robot10/odom") == 0
    assert twins("/robot1/odom", "/robot2/odom") and not twins("/robot1/odom", "/robot1/pose")
    assert not twins("/robot1/odom", "/robot2/lidar/odom")
    assert alike("/points", "/robot2/points") and not alike("/points_raw", "/lio_sam/mapping/cloud_registered")
    assert not alike("/points", "/robot2/lidar/points") and not alike("/points", "/points/odom")
