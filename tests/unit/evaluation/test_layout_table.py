"""The table of real-world bags in docs/reference/bag-layouts.md: every row is made, opened, and does what it says."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from revisit.core.errors import RevisitError
from revisit.core.geometry import se3
from revisit.evaluation.datasets import findings_of, notes_of, open_recording
from tests.support.bag_layouts import (
    MOUNTED,
    PERIOD_NS,
    SCANS,
    START_NS,
    Layout,
    alternating,
    back_in_time,
    body_at,
    deviation,
    fast_lio,
    kiss_icp,
    lio_sam,
    nuscenes_like,
    registered_in_the_body,
    registered_only,
    tf_only,
    two_lidars,
)

pytest.importorskip("rosbags", reason="in the extra `dev`: writes the bags")

PAGE = Path(__file__).resolve().parents[3] / "docs/reference/bag-layouts.md"
OFTEN = [START_NS - 37_000_000 + 20_000_000 * index for index in range(42)]
NOT_MOVED = lambda stamp: np.eye(4)  # noqa: E731


def livox_with_fast_lio() -> Layout:
    layout = Layout().livox("/livox/lidar").clouds("/cloud_registered", "camera_init", NOT_MOVED)
    return layout.odometry("/Odometry", "camera_init", "body")


def camera_and_lidar() -> Layout:
    layout = Layout().raw("/points", "lidar").odometry("/odom", "odom", "lidar")
    for _ in range(3):
        layout.raw("/camera/depth/points", "camera_optical", MOUNTED)
    return layout.transform("lidar", "camera_optical", MOUNTED, moving=False)


def late_odometry() -> Layout:
    layout = Layout().raw("/points", "lidar").odometry("/odom", "odom", "lidar")
    layout.rows = [row for row in layout.rows if row[1] != "/odom" or row[0] > START_NS + 3 * PERIOD_NS]
    return layout


def odometry_with_a_gap() -> Layout:
    """From the fifth scan on all is three seconds later, and the odometry begins again only behind the seventh."""
    layout, silent_from = Layout().raw("/points", "lidar").odometry("/odom", "odom", "lidar"), START_NS + 4 * PERIOD_NS
    rows, layout.rows = layout.rows, []
    for at, topic, kind, message in rows:
        header = message.header
        if at > silent_from:
            header = replace(header, stamp=replace(header.stamp, sec=header.stamp.sec + 3))
        if topic != "/odom" or not silent_from < at < silent_from + 2 * PERIOD_NS:
            layout.rows.append((at, topic, kind, replace(message, header=header)))
    return layout


def clock_since_boot() -> Layout:
    seen = lambda stamp: se3.inverse(body_at(stamp))  # noqa: E731
    layout = Layout().clouds("/points", "lidar", seen, stamped=lambda stamp: stamp - START_NS + 5 * 10**9)
    return layout.odometry("/odom", "odom", "lidar")


def clock_set_back() -> Layout:
    layout = Layout().raw("/points", "lidar").odometry("/odom", "odom", "lidar")
    return back_in_time(layout, START_NS + 4 * PERIOD_NS, 9 * PERIOD_NS // 2)


def stamps_of_zero() -> Layout:
    layout = Layout().clouds("/points", "lidar", lambda stamp: se3.inverse(body_at(stamp)), stamped=lambda stamp: 0)
    return layout.odometry("/odom", "odom", "lidar")


def organised() -> Layout:
    seen = lambda stamp: se3.inverse(body_at(stamp) @ MOUNTED)  # noqa: E731
    layout = Layout().clouds("/ouster/points", "os_lidar", seen, organised=True)
    return layout.odometry("/odom", "odom", "base").transform("base", "os_lidar", MOUNTED, moving=False)


def packets() -> Layout:
    layout = Layout().own_type("/velodyne_packets", "velodyne_msgs/msg/VelodyneScan", "std_msgs/Header header")
    return layout.odometry("/odom", "odom", "base")


def flat() -> Layout:
    return Layout().flat_scans("/scan").odometry("/odom", "odom", "base")


def utm() -> Layout:
    far = se3.from_yaw(0.0, (691_000.0, 5_334_000.0, 520.0))
    return Layout().raw("/points", "lidar").transform("utm", "lidar", lambda stamp: far @ body_at(stamp), moving=True)


def whole(layout: Callable[[], Layout]) -> Callable[[Path], Path]:
    return lambda folder: layout().write2(folder / "drive")


def ros1(compression: str | None) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        layout = Layout(ros1=True).raw("/velodyne_points", "velodyne", MOUNTED)
        layout.odometry("/odom", "odom", "base_link").transform("base_link", "velodyne", MOUNTED, moving=False)
        return layout.write1(folder / "drive.bag", compression)

    return write


def split(folder: Path) -> Path:
    rows, middle = fast_lio().rows, START_NS + 4 * PERIOD_NS - 1
    for number in (0, 1):
        half = Layout(rows=[row for row in rows if (row[0] >= middle) == bool(number)])
        file = half.write2(folder / f"half{number}") / f"half{number}.mcap"
        (folder / "drive").mkdir(exist_ok=True)
        file.rename(folder / "drive" / f"drive_{number}.mcap")
    return folder / "drive"


def compressed(by: str, plugin: str) -> Callable[[Path], Path]:
    return lambda folder: fast_lio().write2(folder / "drive", plugin, compressed=by)


def livox_ros1(folder: Path) -> Path:
    layout = Layout(ros1=True).livox("/livox/lidar", package="livox_ros_driver").odometry("/odom", "odom", "lidar")
    return layout.write1(folder / "drive.bag")


def wheels_and_lidar_odometry() -> Layout:
    layout = kiss_icp().odometry("/odom", "odom", "base_link")
    layout.rows += [(at + 1, *rest) for at, *rest in layout.rows if rest[0] == "/odom"]  # wheels publish more often
    return layout


def elsewhere(stamp_ns: int) -> np.ndarray:
    """Where another robot is, which drives the other way."""
    return se3.from_yaw(2.0, (7.0, 3.0, 0.0)) @ se3.inverse(body_at(stamp_ns))


def fleet() -> Layout:
    layout = Layout().raw("/robot1/points", "lidar").odometry("/robot1/odom", "odom", "lidar", elsewhere)
    return layout.raw("/robot2/points", "lidar").odometry("/robot2/odom", "odom", "lidar", stamps=OFTEN)


def fleet_by_tf() -> Layout:
    layout = (
        Layout().raw("/robot1/points", "lidar").transform("odom", "lidar", body_at, moving=True, namespace="/robot1")
    )
    return layout.transform("odom", "lidar", elsewhere, moving=True, namespace="/robot2")


def cut_short(folder: Path) -> Path:
    """The first part of a bag that was written out often, as a robot leaves it that loses its power."""
    layout = Layout(ros1=True).raw("/points", "lidar").odometry("/odom", "odom", "lidar")
    file = layout.write1(folder / "drive.bag", "LZ4", chunk_bytes=4096)
    file.write_bytes(file.read_bytes()[: int(0.6 * file.stat().st_size)])
    return file


@dataclass(frozen=True)
class Row:
    """`bag` as the page names it; `said` is found in what is said; `scans` is 0 for a refusal."""

    bag: str
    write: Callable[[Path], Path]
    said: str
    scans: int = SCANS
    from_world_m: float = 1e-3


ROWS = [
    Row("FAST-LIO: `/cloud_registered` and `/Odometry` in `camera_init`, `/livox/lidar`", whole(fast_lio),
        "clouds of /livox/lidar"),
    Row("FAST-LIO with Livox `CustomMsg` and `/cloud_registered`", whole(livox_with_fast_lio),
        "clouds of /livox/lidar (frame lidar), 8 of 8 with a pose"),
    Row("FAST-LIO with `/cloud_registered_body`", whole(registered_in_the_body), "clouds of /cloud_registered_body"),
    Row("LIO-SAM: registered clouds and odometry in `odom`, raw clouds, static transforms", whole(lio_sam),
        "clouds of /points_raw"),
    Row("KISS-ICP: `/points`, `/kiss/odometry`, two static transforms to the LiDAR", whole(kiss_icp),
        "the transforms tell where os_lidar is in base_link"),
    Row("nuScenes-like: no odometry, `map` -> `base_link` -> `LIDAR_TOP` on `/tf`", whole(nuscenes_like),
        "poses by the transforms of /tf"),
    Row("`/tf` alone, `map` -> `odom` jumps", whole(tf_only), "the transforms tell where laser is in odom"),
    Row("Registered clouds alone, with odometry", whole(registered_only), "clouds of /cloud_registered"),
    Row("Two LiDARs on one robot", whole(two_lidars), "not used: /rear/points; --topic chooses"),
    Row("A LiDAR, and a depth camera at three times its rate", whole(camera_and_lidar),
        "not used: /camera/depth/points; --topic chooses"),
    Row("Two LiDARs that publish on one topic, each in its frame", whole(alternating),
        "clouds of /points (frames left, right), 8 of 8 with a pose"),
    Row("A path (`nav_msgs/Path`) in place of odometry",
        whole(lambda: Layout().raw("/points", "lidar").path("/lio_sam/mapping/path", "odom")),
        "poses of /lio_sam/mapping/path"),
    Row("Motion capture (`geometry_msgs/TransformStamped`)",
        whole(lambda: Layout().raw("/points", "lidar").tracked("/vicon/robot", "world", "lidar")),
        "poses of /vicon/robot (frame world, following lidar)"),
    Row("Ouster: organised, float64, padded rows, half of the points NaN", whole(organised),
        "clouds of /ouster/points"),
    Row("Poses in UTM, millions of metres from the origin", whole(utm), "the transforms tell where lidar is in utm",
        from_world_m=1e6 * 6),
    Row("ROS 1, LZ4", ros1("LZ4"), "clouds of /velodyne_points"),
    Row("ROS 1, bzip2 or uncompressed", ros1("BZ2"), "clouds of /velodyne_points"),
    Row("Livox `CustomMsg` (MID-360, Avia) and odometry, ROS 2",
        whole(lambda: Layout().livox("/livox/lidar").odometry("/odom", "odom", "lidar")), "clouds of /livox/lidar"),
    Row("Livox `CustomMsg` (MID-360, Avia) and odometry, ROS 1", livox_ros1, "clouds of /livox/lidar"),
    Row("Compressed by message (`--compression-mode message`), MCAP or SQLite", compressed("MESSAGE", "SQLITE3"),
        "clouds of /livox/lidar"),
    Row("Compressed by file (`--compression-mode file`), MCAP or SQLite", compressed("FILE", "MCAP"),
        "clouds of /livox/lidar"),
    Row("Split into several files", split, "2 files read as one recording"),
    Row("Odometry of wheels beside that of a LiDAR (`/odom`, `/kiss/odometry`)", whole(wheels_and_lidar_odometry),
        "poses of /kiss/odometry"),
    Row("Several robots: `/robot1/points`, `/robot1/odom`, `/robot2/points`, `/robot2/odom`, frames of the same names",
        whole(fleet), "not used: /robot1/odom; --odometry chooses"),
    Row("Several robots: `/robot1/points`, `/robot1/tf`, `/robot2/tf`, frames of the same names", whole(fleet_by_tf),
        "poses by the transforms of /robot1/tf"),
    Row("Cut short, as by a loss of power", cut_short, "ends within a record, as after a loss of power", scans=3),
    Row("Odometry that began after the clouds", whole(late_odometry), "4 of 8 with a pose", scans=4),
    Row("Odometry that pauses while the robot moves", whole(odometry_with_a_gap),
        "warning: 3 clouds lie in gaps of the poses, in which the robot moved, and were left out", scans=5),
    Row("A clock that was set back during the drive", whole(clock_set_back),
        "the stamps of /odom go back by 0.350 s", scans=7, from_world_m=60.0),
    Row("No static transform from the body to the LiDAR",
        whole(lambda: Layout().raw("/points", "lidar", MOUNTED).odometry("/odom", "odom", "base")),
        "warning: nothing tells where lidar is in base: taken as the same; else say it with --T-body-sensor",
        from_world_m=60.0),
    Row("No frames named, neither by the clouds nor by what the poses follow",
        whole(lambda: Layout().raw("/points", "", MOUNTED).odometry("/odom", "odom", "")),
        "warning: nothing tells where the sensor is in what the poses follow: taken as the same",
        from_world_m=60.0),
    Row("`/tf` alone, and no static transform from the body to the LiDAR",
        whole(lambda: Layout().raw("/points", "lidar").transform("odom", "base", body_at, moving=True)),
        "base is in odom, but not where lidar of /points sits on it: say it with --T-body-sensor", scans=0),
    Row("Clouds alone, no poses", whole(lambda: Layout().raw("/points", "lidar")),
        "`--odometry kiss-icp` makes poses of the clouds", scans=0),
    Row("Livox `CustomMsg` alone, no poses", whole(lambda: Layout().livox("/livox/lidar")),
        "`--odometry kiss-icp` makes poses of the clouds", scans=0),
    Row("Packets of the driver alone (`VelodyneScan`, Ouster `PacketMsg`)", whole(packets),
        "record the sensor_msgs/PointCloud2 that it publishes", scans=0),
    Row("A 2D scanner (`LaserScan`)", whole(flat), "a 3D LiDAR is needed", scans=0),
    Row("Clouds stamped since the sensor's start, poses by the computer's clock", whole(clock_since_boot),
        "are both stamped by one clock?", scans=0),
    Row("Clouds stamped 0", whole(stamps_of_zero), "are both stamped by one clock?", scans=0),
]  # fmt: skip


@pytest.mark.parametrize("row", ROWS, ids=lambda row: re.sub(r"\W+", "-", row.bag)[:50])
def test_every_bag_of_the_table_is_read_right_or_refused_with_advice(tmp_path: Path, row: Row) -> None:
    bag = row.write(tmp_path)
    if row.scans == 0:
        with pytest.raises(RevisitError) as refused:
            open_recording(bag)
        assert row.said in refused.value.message
        return
    recording = open_recording(bag)
    assert len(recording) == row.scans
    assert row.said in " | ".join([*notes_of(recording), *(finding.measured for finding in findings_of(recording))])
    assert deviation(recording) < row.from_world_m


def test_poses_in_utm_keep_their_millimetres(tmp_path: Path) -> None:
    recording = open_recording(utm().write2(tmp_path / "drive"))
    steps = np.diff([recording.pose(index)[:3, 3] for index in range(SCANS)], axis=0)
    near = open_recording(Layout().raw("/points", "lidar").transform("odom", "lidar", body_at, moving=True)
                          .write2(tmp_path / "near"))  # fmt: skip
    assert np.allclose(steps, np.diff([near.pose(index)[:3, 3] for index in range(SCANS)], axis=0), atol=1e-6)


def test_the_page_has_exactly_these_rows() -> None:
    lines = [line for line in PAGE.read_text().splitlines() if line.startswith("| ")]
    cells = [line.removeprefix("| ").split(" | ") for line in lines]
    assert [(bag, outcome.split()[0].rstrip(",:")) for bag, outcome, *_ in cells[1:]] == [
        (row.bag, "refused" if row.scans == 0 else "read") for row in ROWS
    ]
