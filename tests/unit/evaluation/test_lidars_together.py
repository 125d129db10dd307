"""Two LiDARs of one robot in a bag, used together: their clouds are merged sweep by sweep."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from revisit.cli.recordings import opened
from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.evaluation.datasets import WantedTopics, notes_of, open_bag
from tests.support.bag_layouts import MOUNTED, PERIOD_NS, SCANS, WORLD, Layout, body_at, two_lidars

pytest.importorskip("rosbags", reason="in the extra `dev`: writes the bags")

TOGETHER = WantedTopics("/front/points", together=("/rear/points",))
REAR = se3.from_yaw(np.pi, (-1.0, 0.0, 1.0))


def later(layout: Layout, topic: str, by_ns: int, kept=lambda index: True) -> Layout:
    """The clouds of a topic taken so much later, from where the robot is then; those that are not `kept` are lost."""
    mounted = {"/front/points": MOUNTED, "/rear/points": REAR}[topic]
    frame = topic.split("/")[1]
    stamps = [row[0] + by_ns for row in layout.rows if row[1] == topic]
    layout.rows = [row for row in layout.rows if row[1] != topic]
    for index, stamp in enumerate(stamps):
        if kept(index):
            cloud = layout._cloud(stamp, frame, se3.inverse(body_at(stamp) @ mounted))
            layout.rows.append((stamp, topic, "sensor_msgs/msg/PointCloud2", cloud))
    return layout


def from_world(recording) -> list[float]:
    """How far the points of each scan lie from the world, once for each LiDAR in it, metres."""
    moved = [se3.apply(scan.T_odom_sensor, scan.points.astype(float)) for scan in recording]
    return [float(np.abs(points.reshape(-1, *WORLD.shape) - WORLD).max()) for points in moved]


def test_each_scan_holds_the_clouds_of_both(tmp_path: Path) -> None:
    recording = open_bag(two_lidars().write2(tmp_path / "drive"), TOGETHER)
    assert [len(scan.points) for scan in recording] == [2 * len(WORLD)] * SCANS
    assert max(from_world(recording)) < 1e-4
    told = " | ".join(notes_of(recording))
    assert "clouds of /rear/points (frame rear) are in 8 of 8 scans" in told and "not used" not in told
    assert "warning" not in told


def test_the_scan_is_that_of_the_first_lidar_in_pose_and_time(tmp_path: Path) -> None:
    bag = later(two_lidars(), "/rear/points", 30_000_000).write2(tmp_path / "drive")
    alone, both = open_bag(bag, WantedTopics("/front/points")), open_bag(bag, TOGETHER)
    assert np.array_equal(alone.stamps_ns, both.stamps_ns)
    assert np.array_equal(alone.T_world_sensor, both.T_world_sensor)


@pytest.mark.parametrize("by_ms", [-45, 30, 49])
def test_the_way_between_the_two_stamps_is_driven(tmp_path: Path, by_ms: int) -> None:
    layout = later(two_lidars(), "/rear/points", by_ms * 1_000_000)
    layout.rows = [row for row in layout.rows if row[1] != "/odom"]
    every = [stamp for index in range(-2, 22) for stamp in [1_700_000_000 * 10**9 + index * PERIOD_NS // 2]]
    recording = open_bag(
        layout.odometry("/odom", "odom", "base_link", stamps=every).write2(tmp_path / "drive"), TOGETHER
    )
    assert max(from_world(recording)) < 1e-4
    assert f"at most {abs(by_ms)} ms apart" in " | ".join(notes_of(recording))


def test_clouds_that_no_scan_is_near_are_left_out_and_counted(tmp_path: Path) -> None:
    layout = later(two_lidars(), "/rear/points", 0)
    extra = later(two_lidars(), "/rear/points", 40_000_000)
    layout.rows += [row for row in extra.rows if row[1] == "/rear/points"]
    recording = open_bag(layout.write2(tmp_path / "drive"), TOGETHER)
    assert [len(scan.points) for scan in recording] == [2 * len(WORLD)] * SCANS
    assert max(from_world(recording)) < 1e-4
    warned = [note for note in notes_of(recording) if note.startswith("warning")]
    assert len(warned) == 1 and "8 clouds of /rear/points were left out" in warned[0]


def test_a_scan_whose_partner_is_lost_is_kept_alone(tmp_path: Path) -> None:
    bag = later(two_lidars(), "/rear/points", 0, kept=lambda index: index % 2 == 0).write2(tmp_path / "drive")
    recording = open_bag(bag, TOGETHER)
    assert [len(scan.points) // len(WORLD) for scan in recording] == [2, 1] * (SCANS // 2)
    assert "are in 4 of 8 scans" in " | ".join(notes_of(recording))


def test_poses_by_transforms_alone_serve_both(tmp_path: Path) -> None:
    layout = two_lidars()
    layout.rows = [row for row in layout.rows if row[1] != "/odom"]
    recording = open_bag(
        layout.transform("odom", "base_link", body_at, moving=True).write2(tmp_path / "drive"), TOGETHER
    )
    assert [len(scan.points) for scan in recording] == [2 * len(WORLD)] * SCANS and max(from_world(recording)) < 1e-4


def test_the_option_takes_several_topics(tmp_path: Path) -> None:
    bag = two_lidars().write2(tmp_path / "drive")
    assert len(opened(bag, "auto", "/front/points, /rear/points", None, None).scan(0).points) == 2 * len(WORLD)


def unknown_rear() -> Layout:
    layout = Layout().raw("/front/points", "front", MOUNTED).raw("/rear/points", "rear", REAR)
    return layout.odometry("/odom", "odom", "base_link").transform("base_link", "front", MOUNTED, moving=False)


REFUSED = {
    "no mounting of the second": (unknown_rear, TOGETHER, "cannot be used together.*Record /tf_static"),
    "no such topic": (two_lidars, WantedTopics("/front/points", together=("/left",)), "no clouds on /left"),
    "twice": (two_lidars, WantedTopics("/front/points", together=("/front/points",)), "named twice"),
    "one mounting for both": (
        two_lidars,
        WantedTopics("/front/points", T_body_sensor=MOUNTED, together=("/rear/points",)),
        "is of one sensor",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_lidars_that_cannot_be_used_together_are_refused_with_advice(tmp_path: Path, case: str) -> None:
    layout, wanted, advice = REFUSED[case]
    with pytest.raises(BadField, match=advice):
        open_bag(layout().write2(tmp_path / "drive"), wanted)
