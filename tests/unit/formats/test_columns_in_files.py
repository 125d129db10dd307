"""Every column of a point in every file that has room for it, read back by readers that are not ours."""

from __future__ import annotations

import base64
import io
import json
import struct
from datetime import UTC, datetime

import laspy
import numpy as np
import open3d as o3d
import pytest
import trimesh
import zstandard
from mcap.reader import make_reader

from revisit.core.errors import BadField, MalformedBody
from revisit.core.point_columns import COLUMNS, same
from revisit.formats import (
    PCD,
    PLY,
    POINTCLOUD2,
    QUANTISED,
    decode_cloud,
    laz,
    mcap_map,
    pcd,
    ply,
    pointcloud2,
    quantised,
)
from revisit.formats.point_times import timed

COUNT = 500
STAMP_NS = 1_700_000_000_123_456_789
POINTS = np.random.default_rng(3).uniform(-40.0, 40.0, (COUNT, 3)).astype(np.float32)
NUMBER = np.arange(COUNT)
OFFSETS_NS = (NUMBER - 100) * 160_000
SENT = {
    "intensity": (NUMBER % 256).astype(np.float32),
    "ring": (NUMBER % 200).astype(np.uint16),
    "time": OFFSETS_NS.astype(np.int32),
    "rgb": np.column_stack([NUMBER % 251, NUMBER % 241, NUMBER % 239]).astype(np.uint8),
}
GIVEN_OUT = {**SENT, "time": (STAMP_NS + OFFSETS_NS) / 1e9}
"""As a submap is given out: times are those of the clock, seconds."""


@pytest.mark.parametrize(("kind", "encode"), [(PCD, pcd.encode), (PLY, ply.encode), (POINTCLOUD2, pointcloud2.encode)])
def test_a_file_of_ours_has_every_column_that_is_wanted_of_it_and_no_other(kind, encode):
    data = encode(POINTS, GIVEN_OUT)
    assert same(decode_cloud(data, kind, wanted=COLUMNS).columns, GIVEN_OUT)
    assert tuple(decode_cloud(data, kind).columns) == ("intensity",)
    assert np.abs(timed(GIVEN_OUT, STAMP_NS)["time"] - OFFSETS_NS).max() < 1000


@pytest.mark.parametrize("colour", ["rgb F 4 1", "rgba U 4 1"])
@pytest.mark.parametrize("data", ["ascii", "binary"])
def test_colours_in_one_field_as_pcl_packs_them_are_read(colour, data):
    name, kind, size, _ = colour.split()
    header = f"FIELDS x y z {name} laser_id\nSIZE 4 4 4 {size} 2\nTYPE F F F {kind} U\nWIDTH 2\nHEIGHT 1\nPOINTS 2\n"
    bits = np.array([0x00010203, 0x00FEDC0A], "<u4")
    rows = np.zeros(2, [("xyz", "<f4", 3), ("c", "<f4" if kind == "F" else "<u4"), ("l", "<u2")])
    rows["c"], rows["l"] = bits.view(rows.dtype["c"]), [7, 300]
    lines = (
        "".join(f"0 0 0 {row['c']!r} {row['l']}\n" for row in rows).replace("np.float32(", "").replace("np.uint32(", "")
    )
    body = lines.replace(")", "").encode() if data == "ascii" else rows.tobytes()
    found = decode_cloud(header.encode() + f"DATA {data}\n".encode() + body, PCD, wanted=COLUMNS).columns
    assert found["rgb"].tolist() == [[1, 2, 3], [0xFE, 0xDC, 0x0A]]
    assert found["ring"].tolist() == [7, 300] and found.keys() == {"rgb", "ring"}


@pytest.mark.parametrize(("extension", "encode"), [("pcd", pcd.encode), ("ply", ply.encode)])
def test_open3d_reads_colours_rings_and_times(tmp_path, extension, encode):
    file = tmp_path / f"cloud.{extension}"
    file.write_bytes(encode(POINTS, GIVEN_OUT))
    found = o3d.t.io.read_point_cloud(str(file)).point
    np.testing.assert_array_equal(found["positions"].numpy(), POINTS)
    np.testing.assert_array_equal(found["colors"].numpy(), SENT["rgb"])
    for name in ("intensity", "ring", "time"):
        np.testing.assert_array_equal(found[name].numpy()[:, 0], GIVEN_OUT[name])


def test_trimesh_reads_the_ring_of_ply():
    read = trimesh.load(io.BytesIO(ply.encode(POINTS, GIVEN_OUT)), file_type="ply", process=False)
    np.testing.assert_array_equal(read.metadata["_ply_raw"]["vertex"]["data"]["ring"], SENT["ring"])


CHOICES = [("intensity",), ("time",), ("rgb",), ("ring",), ("time", "rgb"), tuple(COLUMNS)]


def checked_by_laspy(found, names, rows=slice(None)):
    """What laspy read, against the columns with such names."""
    if "ring" in names:
        np.testing.assert_array_equal(found["ring"], SENT["ring"][rows])
    if "rgb" in names:
        assert (np.column_stack([found.red, found.green, found.blue]) == 257 * SENT["rgb"][rows].astype(int)).all()
    if "time" in names:
        assert found.header.global_encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
        ahead_s = 1e9 + (datetime(1980, 1, 6, tzinfo=UTC).timestamp()) - 18
        np.testing.assert_allclose(found.gps_time + ahead_s, GIVEN_OUT["time"][rows], rtol=0, atol=1e-6)
    assert ("ring" in names) == ("ring" in found.point_format.extra_dimension_names)


@pytest.mark.parametrize("names", CHOICES)
def test_laspy_reads_the_columns_of_laz(names):
    found = laspy.read(io.BytesIO(laz.encode(POINTS, 25832, {name: GIVEN_OUT[name] for name in names})))
    np.testing.assert_allclose(found.xyz, POINTS, atol=0.00051)
    assert found.header.vlrs.get("GeoKeyDirectoryVlr")
    checked_by_laspy(found, names)


@pytest.mark.parametrize("names", CHOICES)
def test_laspy_reads_the_columns_of_copc(tmp_path, names):
    copc = pytest.importorskip("revisit.formats.copc", reason="in the extra `crs`")
    copc.write(tmp_path / "a.copc.laz", POINTS, columns={name: GIVEN_OUT[name] for name in names})
    found = laspy.read(tmp_path / "a.copc.laz")
    order = np.lexsort(np.round(found.xyz, 3).T)
    found.points = found.points[order]
    checked_by_laspy(found, names, np.lexsort(np.round(POINTS.astype(np.float64), 3).T))
    with pytest.raises(BadField, match="rings up to 255"):
        copc.write(tmp_path / "b.copc.laz", POINTS, columns={"ring": SENT["ring"] + 256})


@pytest.mark.parametrize(
    ("when", "seconds"),
    [("2011-09-14T01:46:25", 0.0), ("2016-12-31T23:59:59", 167_264_016.0), ("2017-01-01T00:00:00", 167_264_018.0)],
)
def test_a_time_is_gps_time_with_the_leap_seconds_of_its_day(when, seconds):
    unix_s = datetime.fromisoformat(when).replace(tzinfo=UTC).timestamp()
    columns = {"time": np.array([unix_s])}
    assert laspy.read(io.BytesIO(laz.encode(POINTS[:1], columns=columns))).gps_time[0] == seconds


def test_a_reader_of_mcap_finds_a_field_for_each_column():
    data = mcap_map.encode({}, POINTS, columns=GIVEN_OUT)
    ((_, _, message),) = make_reader(io.BytesIO(data)).iter_messages(topics="/map/cloud")
    told = json.loads(message.data)
    kinds = {1: "u1", 3: "<u2", 7: "<f4", 8: "<f8"}
    fields = told["fields"]
    record = np.dtype({"names": [one["name"] for one in fields], "formats": [kinds[one["type"]] for one in fields],
                       "offsets": [one["offset"] for one in fields], "itemsize": told["point_stride"]})  # fmt: skip
    rows = np.frombuffer(base64.b64decode(told["data"]), record)
    for name in ("intensity", "ring", "time"):
        np.testing.assert_array_equal(rows[name], GIVEN_OUT[name])
    np.testing.assert_array_equal(np.column_stack([rows[one] for one in ("red", "green", "blue")]), SENT["rgb"])


@pytest.mark.parametrize("names", [*CHOICES, ()])
def test_the_form_of_the_wire_keeps_times_to_a_microsecond_and_the_others_as_they_are(names):
    sent = {name: SENT[name] for name in names}
    if "time" in names:
        sent["time"] = OFFSETS_NS + 499
    found = decode_cloud(quantised.encode(POINTS, sent), QUANTISED)
    assert tuple(found.columns) == tuple(name for name in COLUMNS if name in names)
    for name in names:
        assert found.columns[name].dtype == COLUMNS[name].kind
        np.testing.assert_allclose(found.columns[name].astype(float), SENT[name], atol=0.002 * (name == "intensity"))


@pytest.mark.parametrize("name", ["ring", "time", "rgb"])
def test_the_ends_of_a_range_travel_and_what_is_beyond_does_not(name):
    column, points = COLUMNS[name], POINTS[:4]
    shape = (4, 3) if name == "rgb" else (4,)
    ends = np.broadcast_to(np.array([column.low, column.high] * 2).reshape(4, *[1] * (len(shape) - 1)), shape)
    found = decode_cloud(quantised.encode(points, {name: ends}), QUANTISED).columns[name]
    np.testing.assert_array_equal(found, ends)
    for beyond in (column.low - 1, column.high + 1):
        with pytest.raises(BadField, match=name):
            quantised.encode(points, {name: np.full(shape, beyond)})


def test_a_cloud_that_was_made_with_a_time_beyond_its_range_is_refused():
    good = quantised.encode(POINTS[:1], {"time": np.array([2_000_000_000])})
    planes = bytearray(zstandard.decompress(good[20:]))
    (coded,) = struct.unpack("<I", planes[12:])
    planes[12:] = struct.pack("<I", coded + 2)
    with pytest.raises(MalformedBody, match="has a time that is not"):
        decode_cloud(good[:20] + zstandard.compress(bytes(planes)), QUANTISED)


def test_a_column_that_a_later_release_may_have_is_refused():
    good = quantised.encode(POINTS)
    with pytest.raises(MalformedBody, match="a column that is not known"):
        decode_cloud(good[:18] + struct.pack("<H", 8) + good[20:], QUANTISED)
