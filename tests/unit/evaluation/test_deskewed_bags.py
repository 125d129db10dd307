"""A spinning LiDAR on a robot that drives and turns, in a made-up room: its bag is blurred, and sharp once deskewed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.cli.recordings import opened
from revisit.core.geometry import se3
from revisit.evaluation.datasets import WantedTopics, notes_of, open_bag
from tests.support.bag_layouts import PERIOD_NS, START_NS, WORLD, Layout, body_at, deviation, scan_stamps

pytest.importorskip("rosbags", reason="in the extra `dev`: writes the bags")

ROOM_M = np.array([12.0, 9.0, 3.0])
RAYS, RINGS = 360, 8
EVERY_20_MS = [START_NS + step * 20_000_000 for step in range(-5, 50)]


def seen_from(T_room_sensor: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """Where a ray (3,) of the sensor meets a wall of the room, in the sensor's frame."""
    origin, direction = T_room_sensor[:3, 3], T_room_sensor[:3, :3] @ ray
    with np.errstate(divide="ignore"):
        reach = np.where(direction > 0, ROOM_M - origin, -ROOM_M - origin) / direction
    return ray * reach.min()


def sweep(stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) and times (n,) of one turn of the sensor, which moves meanwhile."""
    points, times = [], []
    for turn in range(RAYS):
        offset = turn * PERIOD_NS // RAYS
        azimuth, T_room_sensor = 2 * np.pi * turn / RAYS, body_at(stamp_ns + offset)
        for ring in np.radians(np.linspace(-12, 12, RINGS)):
            ray = np.array([np.cos(ring) * np.cos(azimuth), np.cos(ring) * np.sin(azimuth), np.sin(ring)])
            points.append(seen_from(T_room_sensor, ray))
            times.append(offset)
    return np.array(points), np.array(times)


def spinning(field: str = "t", topic: str = "/points", timed: bool = True, later_ns: int = 0) -> Layout:
    layout = Layout().odometry("/odom", "odom", "lidar", stamps=EVERY_20_MS)
    kinds = [(name, 4 * index, 7) for index, name in enumerate("xyz")] + ([(field, 12, 6)] if timed else [])
    kinds += [("channel", 16, 4), ("rgb", 18, 7)]
    fields = [
        layout.types["sensor_msgs/msg/PointField"](name=name, offset=at, datatype=kind, count=1)
        for name, at, kind in kinds
    ]
    for stamp in (one + later_ns for one in scan_stamps()):
        points, times = sweep(stamp)
        told = [(name, kind) for name, kind in zip("xyztrc", ("<f4", "<f4", "<f4", "<u4", "<u2", "<u4"), strict=True)]
        rows = np.zeros(len(points), told)
        rows["x"], rows["y"], rows["z"], rows["t"] = *points.T, times
        rows["r"], rows["c"] = np.tile(np.arange(RINGS), RAYS), 0x00102030 + np.arange(len(points)) % 8
        cloud = layout.types["sensor_msgs/msg/PointCloud2"](
            header=layout.header(stamp, "lidar"), height=1, width=len(rows), fields=fields, is_bigendian=False,
            point_step=22, row_step=22 * len(rows), data=np.frombuffer(rows.tobytes(), np.uint8), is_dense=True,
        )  # fmt: skip
        layout.rows.append((stamp, topic, "sensor_msgs/msg/PointCloud2", cloud))
    return layout


def blur_m(recording) -> float:
    """How far the points lie from the nearest wall: the 99th percentile, metres."""
    points = np.vstack([se3.apply(scan.T_odom_sensor, scan.points.astype(float)) for scan in recording])
    return float(np.percentile(np.abs(np.abs(points) - ROOM_M).min(axis=1), 99))


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    return spinning().write2(tmp_path_factory.mktemp("spinning") / "drive")


def test_a_blurred_room_is_sharp_once_it_is_deskewed(bag: Path) -> None:
    before, after = (blur_m(open_bag(bag, WantedTopics(deskew=deskew))) for deskew in (False, True))
    assert before > 0.2 and after < 0.005


def test_inspect_names_the_columns_that_ingest_could_send(bag: Path) -> None:
    answer = CliRunner().invoke(app, ["inspect", str(bag), "--json"])
    assert json.loads(answer.stdout)["figures"]["point_columns"] == "ring, time, rgb"


def test_points_that_are_deskewed_keep_their_ring_time_and_colour(bag: Path) -> None:
    recording = open_bag(bag)
    plain, scan = recording.scan(3), replace(recording, columns=("ring", "time", "rgb")).scan(3)
    assert np.array_equal(scan.points, plain.points) and not plain.columns
    number = np.arange(len(scan.points))
    assert np.array_equal(scan.columns["time"], sweep(int(recording.stamps_ns[3]))[1])
    assert np.array_equal(scan.columns["ring"], number % RINGS)
    assert np.array_equal(
        scan.columns["rgb"], np.column_stack([0 * number + 0x10, 0 * number + 0x20, 0x30 + number % 8])
    )


def test_the_times_of_two_lidars_count_from_the_stamp_of_their_scan(tmp_path: Path) -> None:
    layout, other = spinning(topic="/front/points"), spinning(topic="/rear/points", later_ns=30_000_000)
    layout.rows += [row for row in other.rows if row[1] == "/rear/points"]
    together = WantedTopics("/front/points", together=("/rear/points",))
    recording = replace(open_bag(layout.write2(tmp_path / "drive"), together), columns=("ring", "time"))
    times = recording.scan(3).columns["time"].reshape(2, -1)
    assert np.array_equal(times[1] - times[0], np.full(RAYS * RINGS, 30_000_000))
    assert recording.scan(3).columns["ring"].max() == RINGS - 1, "rings are those of each LiDAR"


def test_that_it_is_deskewed_is_told_and_can_be_switched_off(bag: Path, capsys) -> None:
    assert any("moved to the stamp of its cloud" in note for note in notes_of(open_bag(bag)))
    assert blur_m(opened(bag, "auto", None, None, None, deskew=False)) > 0.2
    assert "moved to the stamp" not in capsys.readouterr().err


def test_clouds_without_times_are_left_as_they_are(tmp_path: Path) -> None:
    recording = open_bag(spinning(timed=False).write2(tmp_path / "drive"))
    assert blur_m(recording) > 0.2 and not any("moved to the stamp" in note for note in notes_of(recording))


def test_clouds_that_were_deskewed_by_their_publisher_are_left_as_they_are(tmp_path: Path) -> None:
    recording = open_bag(spinning(topic="/cloud_deskewed").write2(tmp_path / "drive"))
    assert np.allclose(recording.scan(0).points, sweep(START_NS)[0], atol=1e-4)


def test_a_scan_whose_end_has_no_pose_is_moved_as_far_as_the_poses_go(tmp_path: Path) -> None:
    layout = spinning()
    last = scan_stamps()[-1]
    layout.rows = [row for row in layout.rows if row[1] != "/odom" or row[0] <= last]
    recording = open_bag(layout.write2(tmp_path / "drive"))
    assert len(recording) == len(scan_stamps())
    assert np.allclose(recording.scan(len(recording) - 1).points, sweep(last)[0], atol=1e-4)


def as_it_turns(at: int, message):
    """A cloud of Livox with its points taken one after the other; another message as it is."""
    if not hasattr(message, "points"):
        return message
    offsets = np.arange(len(WORLD)) * 300_000
    seen = [se3.inverse(body_at(at + ns))[:3] @ [*point, 1.0] for ns, point in zip(offsets, WORLD, strict=True)]
    moved = zip(message.points, offsets, seen, strict=True)
    points = [replace(point, offset_time=int(ns), x=x, y=y, z=z) for point, ns, (x, y, z) in moved]
    return replace(message, points=points)


def test_points_of_livox_are_moved_by_their_offset(tmp_path: Path) -> None:
    layout = Layout().livox("/livox/lidar").odometry("/odom", "odom", "lidar", stamps=EVERY_20_MS)
    layout.rows = [(at, topic, kind, as_it_turns(at, message)) for at, topic, kind, message in layout.rows]
    bag = layout.write2(tmp_path / "drive")
    assert deviation(open_bag(bag, WantedTopics(deskew=False))) > 0.2
    assert deviation(open_bag(bag)) < 2e-3
