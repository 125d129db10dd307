"""Bags as real robots record them, written by an independent library: each is read right or refused with advice.

A recording is right where every scan, moved by its pose, lies on the one world that all of them saw.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from mcap.writer import Writer

from revisit.cli.recordings import opened
from revisit.core.errors import BadField, MalformedBody, RevisitError
from revisit.core.geometry import se3
from revisit.evaluation.datasets import WantedTopics, notes_of, open_bag, open_recording
from revisit.evaluation.datasets.bag_files import is_bag
from tests.support.bag_layouts import (
    MOUNTED,
    PERIOD_NS,
    SCANS,
    START_NS,
    WORLD,
    Layout,
    body_at,
    deviation,
    fast_lio,
    kiss_icp,
    lio_sam,
    nuscenes_like,
    pose_stamped,
    registered_in_a_map,
    registered_in_the_body,
    registered_only,
    slashed_frames,
    tf_only,
    two_lidars,
)

pytest.importorskip("rosbags", reason="in the extra `dev`: writes the bags")

LAYOUTS = {
    fast_lio: "/livox/lidar",
    lio_sam: "/points_raw",
    kiss_icp: "/points",
    nuscenes_like: "/LIDAR_TOP",
    tf_only: "/scan",
    registered_only: "/cloud_registered",
    registered_in_a_map: "/cloud_in_map",
    registered_in_the_body: "/cloud_registered_body",
    two_lidars: "/front/points",
    pose_stamped: "/points",
    slashed_frames: "/registered",
}


@pytest.mark.parametrize("plugin", ["MCAP", "SQLITE3"])
@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.__name__)
def test_every_scan_lies_on_the_world_and_the_topic_is_told(tmp_path: Path, layout, plugin: str) -> None:
    recording = open_recording(layout().write2(tmp_path / "drive", plugin))
    assert len(recording) == SCANS
    assert deviation(recording) < 1e-4
    assert notes_of(recording)[0].startswith(f"clouds of {LAYOUTS[layout]} (frame ")


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.__name__)
def test_every_scan_is_in_the_frame_of_its_sensor(tmp_path: Path, layout) -> None:
    # Right on the world is not enough: a registered cloud with the identity for its pose is that, too.
    recording = open_bag(layout().write2(tmp_path / "drive"))
    travelled = recording.pose(SCANS - 1)[:3, 3] - recording.pose(0)[:3, 3]
    assert 0.5 < np.linalg.norm(travelled) < 2.0


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_bags_of_ros_1_are_read(tmp_path: Path, compression: str | None) -> None:
    layout = Layout(ros1=True).raw("/velodyne_points", "/velodyne", MOUNTED).odometry("/odom", "/odom", "/base_link")
    layout.transform("/base_link", "/velodyne", MOUNTED, moving=False)
    recording = open_recording(layout.write1(tmp_path / "drive.bag", compression))
    assert len(recording) == SCANS and deviation(recording) < 1e-4


@pytest.mark.parametrize("plugin", ["MCAP", "SQLITE3"])
def test_a_split_bag_is_read_as_one(tmp_path: Path, plugin: str) -> None:
    whole = fast_lio()
    middle = START_NS + 4 * PERIOD_NS - 1
    suffix = {"MCAP": "mcap", "SQLITE3": "db3"}[plugin]
    (tmp_path / "drive").mkdir()
    for number, part in enumerate((lambda row: row[0] < middle, lambda row: row[0] >= middle)):
        half = Layout(rows=[row for row in whole.rows if part(row)]).write2(tmp_path / f"half{number}", plugin)
        (half / f"half{number}.{suffix}").rename(tmp_path / "drive" / f"part_{number}.{suffix}")
    listed = f"  relative_file_paths:\n    - part_0.{suffix}\n    - part_1.{suffix}\n  duration:\n"
    (tmp_path / "drive/metadata.yaml").write_text(f"rosbag2_bagfile_information:\n{listed}")
    recording = open_recording(tmp_path / "drive")
    assert len(recording) == SCANS and deviation(recording) < 1e-4
    assert "2 files read as one recording" in notes_of(recording)


def parts_of(folder: Path, *names: str) -> Path:
    """A recording of ROS 1 in so many parts."""
    whole = Layout(ros1=True).raw("/points", "lidar").odometry("/odom", "odom", "lidar")
    rows = sorted(whole.rows, key=lambda row: row[0])
    folder.mkdir()
    for number, name in enumerate(names):
        half = rows[len(rows) * number // len(names) : len(rows) * (number + 1) // len(names)]
        Layout(ros1=True, rows=half).write1(folder / name)
    return folder


def test_parts_as_ros_1_names_them_are_read_as_one(tmp_path: Path) -> None:
    names = "drive_2026-05-01-10-00-00_0.bag", "drive_2026-05-01-10-05-00_1.bag"
    recording = open_recording(parts_of(tmp_path / "drive", *names))
    assert len(recording) == SCANS and deviation(recording) < 1e-4


@pytest.mark.parametrize("names", [("run_1.bag", "run_2.bag"), ("run_0.bag", "run_2.bag")])
def test_numbered_bags_that_are_not_all_parts_are_no_recording(tmp_path: Path, names: tuple[str, str]) -> None:
    with pytest.raises(BadField, match=f"{names[0]} to {names[1]}.*not all parts of one recording"):
        open_recording(parts_of(tmp_path / "drive", *names))


def test_a_part_that_the_metadata_does_not_list_is_not_passed_over(tmp_path: Path) -> None:
    folder = parts_of(tmp_path / "drive", "part_0.bag", "part_1.bag")
    (folder / "metadata.yaml").write_text("a:\n  relative_file_paths:\n    - part_0.bag\n")
    with pytest.raises(BadField, match=r"does not list part_1\.bag.*reindex"):
        open_recording(folder)


def test_a_bag_is_known_by_its_name_in_capitals_too(tmp_path: Path) -> None:
    assert len(open_recording(parts_of(tmp_path / "drive", "DRIVE.BAG") / "DRIVE.BAG")) == SCANS
    assert len(open_recording(tmp_path / "drive")) == SCANS


def test_an_mcap_file_with_messages_of_ros_1_is_read(tmp_path: Path) -> None:
    layout = Layout(ros1=True).raw("/points", "lidar").odometry("/odom", "odom", "lidar")
    with (tmp_path / "drive.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for topic, kind in {topic: kind for _, topic, kind, _ in layout.rows}.items():
            schema = writer.register_schema(kind.replace("/msg/", "/"), "ros1msg", b"")
            channel = writer.register_channel(topic, "ros1", schema)
            for stamp, name, _, message in layout.rows:
                if name == topic:
                    content = bytes(layout.store.serialize_ros1(message, kind))
                    writer.add_message(channel, stamp, content, stamp)
        writer.finish()
    recording = open_recording(tmp_path / "drive.mcap")
    assert len(recording) == SCANS and deviation(recording) < 1e-4


def records_of(bag: bytes) -> list[int]:
    """Where the records of a bag of ROS 1 begin, those in chunks not among them."""
    found, at = [], len("#ROSBAG V2.0\n")
    while at < len(bag):
        found.append(at)
        for _ in ("header", "content"):
            at += 4 + int.from_bytes(bag[at : at + 4], "little")
    return found


@pytest.mark.parametrize("share", [0.5, 0.9])
@pytest.mark.parametrize("damage", ["cut", "length"])
def test_a_bag_of_ros_1_is_read_as_far_as_its_records_make_sense(tmp_path: Path, share: float, damage: str) -> None:
    layout = Layout(ros1=True).raw("/points", "lidar").odometry("/odom", "odom", "lidar")
    sound = layout.write1(tmp_path / "sound.bag", None, 8000).read_bytes()
    starts = records_of(sound)
    at = starts[int(share * len(starts))]
    kept = sound[: at + 9] if damage == "cut" else sound[:at] + b"\xff" * 4 + sound[at + 4 :]
    (tmp_path / "damaged.bag").write_bytes(kept)
    recording = open_bag(tmp_path / "damaged.bag")
    assert any("ends within a record" in note for note in notes_of(recording)) and deviation(recording) < 1e-4


def test_what_is_wanted_is_taken(tmp_path: Path) -> None:
    bag = two_lidars().odometry("/other", "odom", "base_link").write2(tmp_path / "drive")
    recording = open_bag(bag, WantedTopics("/rear/points", "/other"))
    assert deviation(recording) < 1e-4
    told = " | ".join(notes_of(recording))
    assert "clouds of /rear/points" in told and "poses of /other" in told and "--topic" in told


def test_the_mounting_that_is_given_is_used(tmp_path: Path) -> None:
    bag = Layout().raw("/points", "lidar", MOUNTED).odometry("/odom", "odom", "base").write2(tmp_path / "drive")
    assert deviation(open_bag(bag)) > 0.5
    assert any("--T-body-sensor" in note for note in notes_of(open_bag(bag)))
    assert deviation(open_bag(bag, WantedTopics(T_body_sensor=MOUNTED))) < 1e-4


def test_registered_clouds_in_a_map_far_from_its_origin_keep_their_millimetres(tmp_path: Path) -> None:
    """Float64 in UTM: float32 has steps of half a metre there."""
    T_utm_odom = se3.from_yaw(0.0, (691_000.4, 5_334_000.3, 520.0))
    layout = Layout().clouds("/cloud_registered", "utm", lambda stamp: T_utm_odom, organised=True)
    recording = open_bag(layout.odometry("/odom", "utm", "body", lambda stamp: T_utm_odom @ body_at(stamp))
                         .write2(tmp_path / "drive"))  # fmt: skip
    for scan in recording:
        back = se3.apply(se3.inverse(T_utm_odom) @ scan.T_odom_sensor, scan.points.astype(float))
        assert scan.points.dtype == np.float32
        np.testing.assert_allclose(back, WORLD, atol=1e-4)


REFUSED = {
    "no odometry": (lambda: Layout().raw("/points", "lidar"), {}, "--odometry kiss-icp"),
    "no clouds": (lambda: Layout().odometry("/odom", "odom", "base"), {}, "no sensor_msgs/PointCloud2.*nav_msgs"),
    "clouds that never came": (
        lambda: Layout().silent("/points", "sensor_msgs/msg/PointCloud2").odometry("/odom", "odom", "base"),
        {},
        "^/points holds no message",
    ),
    "poses that never came": (
        lambda: Layout().raw("/points", "lidar").silent("/odom", "nav_msgs/msg/Odometry"),
        {},
        r"/odom \(nav_msgs/msg/Odometry, no usable message\)",
    ),
    "clouds by another clock": (
        lambda: (
            Layout()
            .clouds("/points", "lidar", lambda stamp: np.eye(4), lambda stamp: stamp - START_NS + 5 * 10**9)
            .odometry("/odom", "odom", "lidar")
        ),
        {},
        "stamped 1970-01-01 00:00:05 to 00:00:05 and 2023-11-14 22:13:19 to 22:13:20",
    ),
    "no such topic": (two_lidars, {"topic": "/left"}, "/front/points, /rear/points"),
    "no such odometry": (two_lidars, {"odometry": "/wheels"}, "topics with poses: /odom"),
    "transforms that do not move": (
        lambda: Layout().raw("/points", "lidar").transform("base", "lidar", MOUNTED, moving=False),
        {"odometry": "/tf"},
        "do not tell how lidar moves",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_read_is_refused_with_advice(tmp_path: Path, case: str) -> None:
    layout, wanted, advice = REFUSED[case]
    with pytest.raises(BadField, match=advice):
        open_bag(layout().write2(tmp_path / "drive"), WantedTopics(**wanted))


def test_a_cloud_without_coordinates_is_refused_with_the_fields_that_it_has(tmp_path: Path) -> None:
    layout = Layout().raw("/points", "lidar").odometry("/odom", "odom", "lidar")
    for _, topic, _, message in layout.rows:
        if topic == "/points":
            message.fields[:] = [replace(message.fields[0], name="xyz", count=3)]
    with pytest.raises(BadField, match="no fields x, y and z, but xyz"):
        open_bag(layout.write2(tmp_path / "drive")).scan(0)


@pytest.mark.parametrize("compression", [None, "BZ2"])
def test_a_damaged_bag_of_ros_1_costs_no_more_than_a_refusal(tmp_path: Path, compression: str | None) -> None:
    layout = Layout(ros1=True).raw("/points", "lidar").odometry("/odom", "odom", "base")
    sound = layout.write1(tmp_path / "sound.bag", compression).read_bytes()
    random, refused = np.random.default_rng(3), 0
    for cut in random.integers(13, len(sound), 40):
        damaged = bytearray(sound if cut % 2 else sound[:cut])
        damaged[min(int(cut), len(damaged) - 1)] ^= 0xFF
        (tmp_path / "damaged.bag").write_bytes(damaged)
        try:
            list(open_bag(tmp_path / "damaged.bag"))
        except RevisitError:
            refused += 1
    assert refused > 10


def test_two_drives_in_one_folder_are_not_mixed(tmp_path: Path) -> None:
    Layout(ros1=True).raw("/points", "lidar").write1(tmp_path / "monday.bag")
    Layout(ros1=True).raw("/points", "lidar").write1(tmp_path / "tuesday.bag")
    with pytest.raises(BadField, match="2 bags"):
        open_bag(tmp_path)


@pytest.mark.parametrize("plugin", ["MCAP", "SQLITE3"])
@pytest.mark.parametrize("by", ["MESSAGE", "FILE"])
def test_a_bag_that_ros_2_has_compressed_is_read_as_the_plain_one(tmp_path: Path, plugin: str, by: str) -> None:
    plain = open_bag(fast_lio().write2(tmp_path / "plain", plugin))
    packed = open_bag(fast_lio().write2(tmp_path / "packed", plugin, compressed=by))
    for index in range(SCANS):
        np.testing.assert_array_equal(packed.scan(index).points, plain.scan(index).points)
        np.testing.assert_array_equal(packed.pose(index), plain.pose(index))


def test_one_file_that_is_compressed_needs_no_metadata_and_one_that_is_damaged_says_so(tmp_path: Path) -> None:
    folder = fast_lio().write2(tmp_path / "drive", compressed="FILE")
    (folder / "metadata.yaml").unlink()
    (file,) = folder.iterdir()
    assert is_bag(file) and is_bag(folder) and len(open_bag(folder)) == len(open_bag(file)) == SCANS
    file.write_bytes(file.read_bytes()[:4] + b"damaged")
    with pytest.raises(MalformedBody, match="cannot be unpacked"):
        open_bag(file)


def test_a_compressed_message_that_is_damaged_costs_no_other_one(tmp_path: Path) -> None:
    file = fast_lio().write2(tmp_path / "drive", "SQLITE3", compressed="MESSAGE") / "drive.db3"
    with closing(sqlite3.connect(file)) as store, store:
        clouds = "topic_id = (SELECT id FROM topics WHERE name = '/livox/lidar')"
        last = f"(SELECT max(id) FROM messages WHERE {clouds})"
        assert store.execute(f"UPDATE messages SET data = substr(data, 1, 40) WHERE id = {last}").rowcount == 1
    recording = open_bag(file.parent)
    assert len(recording) == SCANS - 1
    assert "1 messages cannot be read and were left out" in " ".join(notes_of(recording))


def test_a_command_says_on_stderr_which_topics_it_took_and_why(tmp_path: Path, capsys) -> None:
    bag = fast_lio().write2(tmp_path / "drive")
    assert len(opened(bag, "auto", None, None, "0 0 0 0 0 0 1")) == SCANS
    said = capsys.readouterr()
    assert said.out == ""
    assert "clouds of /livox/lidar (frame livox_frame), 8 of 8 with a pose" in said.err
    assert "poses of /Odometry (frame camera_init, following body)" in said.err
    assert "not used: /cloud_registered; --topic chooses" in said.err


@pytest.mark.parametrize("mounting", ["1 2 3", "1 2 3 0 0 0 one"])
def test_a_mounting_is_seven_numbers(tmp_path: Path, capsys, mounting: str) -> None:
    with pytest.raises(typer.Exit):
        opened(tmp_path, "auto", None, None, mounting)
    assert "x y z qx qy qz qw" in capsys.readouterr().err
