"""Bags written by the test: MCAP byte by byte after its specification, and the tables of a .db3."""

from __future__ import annotations

import bz2
import sqlite3
import struct
import tracemalloc
import zlib
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import zstandard

from revisit.core.errors import BadField, MalformedBody, TooLarge, UnsupportedEncoding
from revisit.core.geometry import se3
from revisit.evaluation.datasets import WantedTopics, open_bag
from revisit.evaluation.datasets.bag_message import unpacked_chunk
from revisit.evaluation.datasets.ros_messages import CLOUD_TYPES, read_columns, read_points

MAGIC = b"\x89MCAP0\r\n"
COUNT = 120


def cloud(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-20, 20, (COUNT, 3)).astype(np.float32)


class Cdr:
    """Writes values little-endian, each aligned to its size."""

    def __init__(self) -> None:
        self.data = bytearray()

    def put(self, code: str, *values: float) -> Cdr:
        for value in values:
            self.data += b"\0" * (-len(self.data) % struct.calcsize(code))
            self.data += struct.pack(f"<{code}", value)
        return self

    def raw(self, content: bytes) -> Cdr:
        self.put("I", len(content))
        self.data += content
        return self

    def header(self, stamp_ns: int, frame: bytes = b"lidar\0") -> Cdr:
        return self.put("i", stamp_ns // 10**9).put("I", stamp_ns % 10**9).raw(frame)

    def message(self) -> bytes:
        return b"\0\1\0\0" + bytes(self.data)


def point_cloud(stamp_ns: int, points: np.ndarray, rows: int = 2) -> bytes:
    """An organised cloud of two rows, each followed by 8 bytes of padding."""
    cdr = Cdr().header(stamp_ns).put("I", rows, len(points) // rows, 3)
    for index, name in enumerate((b"x\0", b"y\0", b"z\0")):
        cdr.raw(name).put("I", 4 * index).put("B", 7).put("I", 1)
    step, width = 12, len(points) // rows
    content = b"".join(points[r * width : (r + 1) * width].astype("<f4").tobytes() + b"\0" * 8 for r in range(rows))
    return cdr.put("B", 0).put("I", step, step * width + 8).raw(content).put("B", 1).message()


def odometry(stamp_ns: int, x: float, quaternion_w: float = 1) -> bytes:
    pose = Cdr().header(stamp_ns, b"odom\0").raw(b"base\0").put("d", x, 0, 0, 0, 0, 0, quaternion_w)
    return pose.put("d", *([0.0] * 36)).message()


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def channel(number: int, topic: str, kind: str) -> bytes:
    schema = record(3, struct.pack("<H", number) + text(kind) + text("ros2msg") + text(""))
    return schema + record(4, struct.pack("<HH", number, number) + text(topic) + text("cdr") + struct.pack("<I", 0))


def message(number: int, data: bytes) -> bytes:
    return record(5, struct.pack("<HIQQ", number, 0, 1, 1) + data)


def chunk(records: bytes, compression: str, checksum: int = 0) -> bytes:
    if compression == "lz4":
        from lz4.frame import compress
    else:
        compress = zstandard.compress if compression == "zstd" else bytes
    stored = compress(records)
    head = struct.pack("<QQQI", 0, 0, len(records), checksum) + text(compression)
    return record(6, head + struct.pack("<Q", len(stored)) + stored)


def bag(
    file: Path,
    compression: str | None = "zstd",
    *,
    with_odometry: bool = True,
    more: bytes = b"",
    quaternion_w: float = 1,
) -> Path:
    """Odometry drives 1 m a second for 3 s, 0.25 s late; clouds at 0, 1 and 2 s."""
    start = 1_700_000_000 * 10**9
    records = channel(1, "/points", "sensor_msgs/msg/PointCloud2") + channel(2, "/odom", "nav_msgs/msg/Odometry")
    records += channel(3, "/chatter", "std_msgs/msg/String") + message(3, b"\0\1\0\0\2\0\0\0a\0")
    for second in range(3):
        records += message(1, point_cloud(start + second * 10**9, cloud(second)))
        if with_odometry:
            records += message(2, odometry(start + second * 10**9 + 250_000_000, float(second), quaternion_w))
    records += more
    body = records if compression is None else chunk(records, compression)
    file.write_bytes(MAGIC + record(1, text("ros2") + text("test")) + body + record(2, bytes(20)) + MAGIC)
    return file


@pytest.mark.parametrize("compression", [None, "", "zstd"])
def test_clouds_get_the_poses_between_which_they_were_taken(tmp_path: Path, compression: str | None) -> None:
    bag(tmp_path / "drive.mcap", compression)
    recording = open_bag(tmp_path)
    # The first cloud was taken before the first pose.
    assert recording.name == "drive" and len(recording) == 2
    np.testing.assert_array_equal(recording.scan(1).points, cloud(2))
    np.testing.assert_array_equal(recording.scan(0).points, cloud(1))
    np.testing.assert_allclose(recording.pose(0)[:3, 3], [0.75, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(recording.pose(1)[:3, 3], [1.75, 0.0, 0.0], atol=1e-9)
    assert recording.scan(0).stamp_ns == 1_700_000_001 * 10**9


def test_the_mounting_of_the_sensor_is_applied(tmp_path: Path) -> None:
    mounted = se3.from_yaw(np.pi, (1.0, 0.0, 2.0))
    recording = open_bag(bag(tmp_path / "drive.mcap"), WantedTopics(T_body_sensor=mounted))
    assert se3.yaw(recording.pose(0)) == pytest.approx(np.pi)


def test_a_bag_without_odometry_says_what_it_lacks(tmp_path: Path) -> None:
    with pytest.raises(BadField, match="Odometry"):
        open_bag(bag(tmp_path / "drive.mcap", with_odometry=False))


def test_an_unknown_compression_is_refused_with_the_way_out(tmp_path: Path) -> None:
    with pytest.raises(UnsupportedEncoding, match="zstd"):
        open_bag(bag(tmp_path / "drive.mcap", "brotli"))


def test_lz4_chunks_are_read(tmp_path: Path) -> None:
    pytest.importorskip("lz4", reason="in the extra `evaluation`")
    np.testing.assert_array_equal(open_bag(bag(tmp_path / "drive.mcap", "lz4")).scan(1).points, cloud(2))


@pytest.mark.parametrize("compression", ["zstd", "lz4", "bz2"])
def test_a_chunk_never_unpacks_to_more_than_it_says(compression: str) -> None:
    pack = {"zstd": zstandard.compress, "bz2": bz2.compress}.get(compression)
    pack = pack or pytest.importorskip("lz4.frame", reason="in the extra `evaluation`").compress
    bomb = pack(bytes(200_000_000))
    tracemalloc.start()
    with suppress(MalformedBody, TooLarge):
        assert len(unpacked_chunk(bomb, compression, 64)) == 64
    assert tracemalloc.get_traced_memory()[1] < 20_000_000
    tracemalloc.stop()


@pytest.mark.parametrize("damage", [lambda content: b"PK\3\4" + content, lambda content: content[:2000]])
def test_damaged_bags_are_refused(tmp_path: Path, damage) -> None:
    file = bag(tmp_path / "drive.mcap")
    file.write_bytes(damage(file.read_bytes()))
    with pytest.raises(MalformedBody):
        open_bag(file)


def test_an_mcap_file_that_was_cut_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    file = bag(tmp_path / "drive.mcap", None)
    file.write_bytes(file.read_bytes()[:-500])  # within the last message
    recording = open_bag(file)
    assert len(recording) == 1
    assert "drive.mcap ends within a record" in recording.notes[-1]


def chunk_of_a_cloud(compression: str, *, damaged: bool, with_checksum: bool = True) -> bytes:
    """A cloud and a pose at 3 s in a chunk of their own, perhaps with damage among the points of the cloud."""
    stamp_ns = 1_700_000_003 * 10**9
    records = message(1, point_cloud(stamp_ns, cloud(3))) + message(2, odometry(stamp_ns + 250_000_000, 3.0))
    found = chunk(records, compression, zlib.crc32(records) if with_checksum else 0)
    return found[:500] + bytes(byte ^ 0x55 for byte in found[500:560]) + found[560:] if damaged else found


@pytest.mark.parametrize("compression", ["", "zstd"])
def test_a_damaged_chunk_does_not_cost_the_drive(tmp_path: Path, compression: str) -> None:
    whole = open_bag(with_chunk(tmp_path / "whole.mcap", chunk_of_a_cloud(compression, damaged=False)))
    recording = open_bag(with_chunk(tmp_path / "drive.mcap", chunk_of_a_cloud(compression, damaged=True)))
    assert (len(whole), len(recording)) == (3, 2)
    assert "warning: 1 chunks are damaged, and what was in them is left out" in recording.notes
    assert not any("damaged" in note for note in whole.notes)


def test_a_chunk_without_a_checksum_is_taken_as_it_is(tmp_path: Path) -> None:
    file = with_chunk(tmp_path / "drive.mcap", chunk_of_a_cloud("", damaged=True, with_checksum=False))
    assert len(open_bag(file)) == 3


def with_chunk(file: Path, more: bytes) -> Path:
    """The bag of `bag`, with a chunk behind its own."""
    tail = len(record(2, bytes(20)) + MAGIC)
    content = bag(file).read_bytes()
    file.write_bytes(content[:-tail] + more + content[-tail:])
    return file


@pytest.mark.parametrize("number", [1, 2])
def test_a_message_that_cannot_be_read_does_not_cost_the_drive(tmp_path: Path, number: int) -> None:
    recording = open_bag(bag(tmp_path / "drive.mcap", more=message(number, b"\0\1\0\0") * 2))
    assert len(recording) == 2
    assert "warning: 2 messages cannot be read and were left out" in recording.notes


def test_a_bag_of_messages_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    file = bag(tmp_path / "drive.mcap", with_odometry=False, more=message(2, b"\0\1\0\0"))
    with pytest.raises(MalformedBody, match="/odom: the message ends too early"):
        open_bag(file)


def test_poses_that_are_all_no_rigid_motions_are_named_as_the_cause(tmp_path: Path) -> None:
    with pytest.raises(BadField, match="all 3 in the bag are no rigid motions"):
        open_bag(bag(tmp_path / "drive.mcap", quaternion_w=1.7))


def a_cloud(points: np.ndarray, height: int, row_step: int, padding: int = 0, count: int = 1) -> bytes:
    """A PointCloud2 of one row that says it has `height` rows `row_step` bytes apart."""
    cdr = Cdr().header(0).put("I", height, len(points), 3)
    for index, name in enumerate((b"x\0", b"y\0", b"z\0")):
        cdr.raw(name).put("I", 4 * index).put("B", 7).put("I", count)
    return cdr.put("B", 0).put("I", 12, row_step).raw(points.tobytes() + bytes(padding)).put("B", 1).message()


def test_rows_are_counted_by_the_bytes_that_are_there() -> None:
    with pytest.raises(MalformedBody, match="declares"):
        read_points(a_cloud(cloud(0), 0xFFFFFFFF, 0), CLOUD_TYPES[0])
    with pytest.raises(MalformedBody, match="declares"):
        read_points(a_cloud(cloud(0), 0xFFFFFFFF, 12 * COUNT + 8), CLOUD_TYPES[0])


def test_the_padding_of_a_single_row_and_a_count_of_none_are_read_as_they_are_meant() -> None:
    np.testing.assert_array_equal(
        read_points(a_cloud(cloud(0), 1, 12 * COUNT + 8, padding=8), CLOUD_TYPES[0]), cloud(0)
    )
    np.testing.assert_array_equal(read_points(a_cloud(cloud(0), 1, 12 * COUNT, count=0), CLOUD_TYPES[0]), cloud(0))


@pytest.mark.parametrize(("name", "kind"), [(b"intensity\0", 0), (b"ring\0", 99), (b"", 7)])
def test_what_a_driver_writes_of_other_fields_costs_no_scan(name: bytes, kind: int) -> None:
    cdr = Cdr().header(0).put("I", 1, COUNT, 5)
    for index, field in enumerate((b"x\0", b"y\0", b"z\0", name, name)):
        cdr.raw(field).put("I", 4 * min(index, 3)).put("B", 7 if index < 3 else kind).put("I", 1)
    rows = np.column_stack([cloud(0), np.zeros(COUNT, np.float32)])
    message = cdr.put("B", 0).put("I", 16, 16 * COUNT).raw(rows.tobytes()).put("B", 1).message()
    np.testing.assert_array_equal(read_points(message, CLOUD_TYPES[0]), cloud(0))
    if kind != 7:
        assert not read_columns(message, CLOUD_TYPES[0], ("intensity",))


@pytest.mark.parametrize("name", ["intensity", "Reflectivity"])
def test_the_intensity_of_a_cloud_is_read_beside_its_points(name: str) -> None:
    bright = np.arange(COUNT, dtype=np.uint16)
    kind = np.dtype([("xyz", "<f4", 3), ("bright", "<u2")])
    rows = np.zeros(COUNT, kind)
    rows["xyz"], rows["bright"] = cloud(0), bright
    cdr = Cdr().header(0).put("I", 1, COUNT, 4)
    for index, field in enumerate((b"x\0", b"y\0", b"z\0", name.encode() + b"\0")):
        cdr.raw(field).put("I", 4 * index).put("B", 7 if index < 3 else 4).put("I", 1)
    message = cdr.put("B", 0).put("I", 14, 14 * COUNT).raw(rows.tobytes()).put("B", 1).message()
    np.testing.assert_array_equal(read_points(message, CLOUD_TYPES[0]), cloud(0))
    np.testing.assert_array_equal(read_columns(message, CLOUD_TYPES[0], ("intensity",))["intensity"], bright)


def test_a_sqlite_bag_is_read_like_an_mcap_file(tmp_path: Path) -> None:
    start = 1_700_000_000 * 10**9
    with sqlite3.connect(tmp_path / "drive.db3") as connection:
        connection.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format)")
        connection.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data)")
        kinds = ("sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry", "std_msgs/msg/String")
        topics = [(number + 1, f"/topic{number}", kind) for number, kind in enumerate(kinds)]
        connection.executemany("INSERT INTO topics VALUES (?, ?, ?, 'cdr')", topics)
        rows = [(1, start, point_cloud(start, cloud(0))), (3, start, b"junk")]
        rows += [(2, start + s * 10**9, odometry(start + s * 10**9, float(s))) for s in range(2)]
        connection.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
    recording = open_bag(tmp_path)
    assert len(recording) == 1
    np.testing.assert_array_equal(recording.scan(0).points, cloud(0))


def test_a_file_that_only_claims_to_be_a_sqlite_bag_is_refused(tmp_path: Path) -> None:
    (tmp_path / "drive.db3").write_bytes(b"SQLite format 3\0" + b"\xff" * 2000)
    with pytest.raises(MalformedBody, match="no readable bag"):
        open_bag(tmp_path)
