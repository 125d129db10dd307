"""The bad-input corpus: each case of the table G01-G58 that a parser decides gets exactly its documented error."""

from __future__ import annotations

import gzip
import io
import pickle
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest
import zstandard

from revisit import formats
from revisit.core.errors import BadField, MalformedBody, RevisitError, TooLarge, UnsupportedEncoding
from revisit.core.scan import validate_cloud
from revisit.formats import KITTI, NPY, PCD, PLY, POINTCLOUD2, QUANTISED, CloudLimits, decode_cloud


def refused(error: type[RevisitError], data: bytes, media_type: str, **options: object) -> None:
    with pytest.raises(RevisitError) as caught:
        decode_cloud(data, media_type, **options)
    assert type(caught.value) is error, caught.value


def floats(count: int) -> bytes:
    return np.zeros((count, 4), "<f4").tobytes()


@pytest.mark.parametrize("media_type", formats.MEDIA_TYPES)
def test_an_empty_body_is_malformed(media_type):  # G01
    refused(MalformedBody, b"", media_type)


def test_a_valid_header_without_points_is_an_empty_cloud(make):  # G02
    for data, media_type in [
        (make.pcd(b"", "binary", 0), PCD),
        (make.pcd(b"", "ascii", 0), PCD),
        (make.ply(b"", "binary_little_endian", 0), PLY),
        (make.npy(b"", shape="(0, 4)"), NPY),
        (formats.encode_pointcloud2(np.zeros((0, 3))), POINTCLOUD2),
        (formats.encode_quantised(np.zeros((0, 3))), QUANTISED),
    ]:
        with pytest.raises(RevisitError) as caught:
            validate_cloud(decode_cloud(data, media_type).points)
        assert caught.value.code == "EMPTY_CLOUD"


def test_too_many_points_are_too_large(make):  # G15
    limits = CloudLimits(max_points=119)
    for media_type, data in make.valid(make.records()).values():
        refused(TooLarge, data, media_type, limits=limits)
        assert len(decode_cloud(data, media_type, limits=CloudLimits(max_points=120)).points) == 120


@pytest.mark.parametrize("count", ["100000000", "2147483648", "4294967300", "9223372036854775808", "-1", "1e3", "٣"])
def test_counts_that_the_body_cannot_hold_are_malformed_and_cost_nothing(count, make):  # G16, G17
    # Both parsers are warm before memory is measured: a first import is not an allocation for the body.
    decode_cloud(make.pcd(make.compressed(make.records()), "binary_compressed", 120), PCD)
    tracemalloc.start()
    try:
        for encoding in ("binary", "ascii", "binary_compressed"):
            refused(MalformedBody, make.pcd(bytes(48), encoding, 0, WIDTH=count, POINTS=count), PCD)
        for encoding in ("binary_little_endian", "binary_big_endian", "ascii"):
            refused(MalformedBody, make.ply(bytes(48), encoding, count), PLY)
        refused(MalformedBody, make.npy(bytes(48), shape=f"({count}, 4)"), NPY)
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()


def test_width_times_height_does_not_overflow(make):  # G18
    refused(MalformedBody, make.pcd(floats(4), "binary", 4, WIDTH="65536", HEIGHT="65537", POINTS="4"), PCD)
    packed = formats.PackedCloud((formats.PointField("x", 0, 7),), 16, 65536, floats(4), height=65537)
    refused(MalformedBody, packed.to_bytes(), POINTCLOUD2)


@pytest.mark.parametrize(
    "changes",
    [
        {"SIZE": "3 4 4 4"},  # G19
        {"SIZE": "0 4 4 4"},
        {"SIZE": "-400 4 4 4"},
        {"COUNT": "-1 1 1 1"},  # G20
        {"COUNT": "1073741824 1 1 1"},
        {"COUNT": "0 1 1 1"},
        {"FIELDS": "x x x y"},  # G21
        {"TYPE": "F F F F", "SIZE": "1 4 4 4"},  # G23
        {"TYPE": "Q F F F"},
        {"FIELDS": "x y z"},
        {"DATA": "binary_zipped"},
        {"WIDTH": "5"},
        {"POINTS": "4 4"},
    ],
)
def test_an_impossible_pcd_header_is_malformed(changes, make):
    refused(MalformedBody, make.pcd(floats(4), "binary", 4, **changes), PCD)


def test_a_pcd_without_z_or_with_integer_coordinates_is_a_bad_field(make):  # G22
    refused(BadField, make.pcd(floats(4), "binary", 4, FIELDS="x y height intensity"), PCD)
    refused(BadField, make.pcd(floats(4), "binary", 4, TYPE="I I I F"), PCD)


@pytest.mark.parametrize("rows", [3, 5])
@pytest.mark.parametrize("kind", ["pcd", "ply"])
def test_ascii_rows_must_be_as_many_as_declared(rows, kind, make):  # G24, G25
    body = make.ascii(make.records(rows))
    data, media = (make.pcd(body, "ascii", 4), PCD) if kind == "pcd" else (make.ply(body, "ascii", 4), PLY)
    refused(MalformedBody, data, media)


def test_ascii_rows_may_not_borrow_numbers_from_each_other(make):
    refused(MalformedBody, make.pcd(b"1 2 3\n4 5 6 7 8\n", "ascii", 2), PCD)


@pytest.mark.parametrize("change", [-7, -16, 1, 16])
def test_a_binary_body_is_exactly_as_long_as_declared(change, make):  # G26
    body = floats(8)[:change] if change < 0 else floats(8) + bytes(change)
    refused(MalformedBody, make.pcd(body, "binary", 8), PCD)
    refused(MalformedBody, make.ply(body, "binary_little_endian", 8), PLY)
    refused(MalformedBody, make.npy(body, shape="(8, 4)"), NPY)


def compressed(packed: bytes, packed_size: int | None = None, size: int = 64) -> bytes:
    return struct.pack("<II", len(packed) if packed_size is None else packed_size, size) + packed


@pytest.mark.parametrize(
    "body",
    [
        compressed(b"\x03\x00\x00\x00\x00", size=4),  # G27: fewer bytes than POINTS needs
        compressed(b"\x03\x00\x00\x00\x00", size=64),  # declares 64, yields 4
        compressed(b"\x03\x00\x00\x00\x00", packed_size=0xFFFFFFF0),  # G28
        compressed(b"\x03\x00\x00\x00\x00", size=0xFFFFFFF0),
        compressed(b"\x20\x05"),  # G29: points before the start
        compressed(b"\x1f" + bytes(32) + b"\xe0\xff\x00"),  # runs over the end of the output
        compressed(b"\x1f\x00"),  # literals run over the end of the input
        compressed(b"\x00\x00\xe0"),  # ends inside a reference
        b"\x00\x00",
    ],
)
def test_damaged_lzf_is_malformed(body, make):
    refused(MalformedBody, make.pcd(body, "binary_compressed", 4), PCD)


def test_a_header_line_of_a_megabyte_and_thousands_of_fields_are_malformed(make):  # G30, G33, G40
    refused(MalformedBody, b"# .PCD " + b"x" * 2**20 + b"\n" + make.pcd(floats(4), "binary", 4), PCD)
    many = " ".join(f"f{i}" for i in range(5000))
    refused(MalformedBody, make.pcd(b"", "binary", 0, FIELDS=many, SIZE=many, TYPE=many, COUNT=many), PCD)
    refused(MalformedBody, make.ply(b"", "ascii", 0, properties=f"property float {'x' * 100_000}\n"), PLY)
    refused(MalformedBody, make.ply(b"", "ascii", 0, extra=f"comment {'x' * 2**21}\n"), PLY)
    properties = "".join(f"property uchar p{i}\n" for i in range(20_000))
    refused(MalformedBody, make.ply(bytes(20_000), "binary_little_endian", 1, properties=properties), PLY)


@pytest.mark.parametrize("body", [b"# .PCD\nFIELDS x\n" * 1000, b"VERSION 0.7\nFIELDS x y z\n", b"\n" * 100_000])
def test_a_header_that_never_ends_is_malformed(body):  # G31
    refused(MalformedBody, body, PCD)
    refused(MalformedBody, b"ply\nformat ascii 1.0\ncomment\n" + b"comment\n" * 5000, PLY)


@pytest.mark.parametrize("token", ["1e400", "0x10", "1_0", "1,5", "٣", "nan(0x1)", "infinit", "1e", "--1", "1" * 65])
def test_odd_ascii_numbers_are_malformed(token, make):  # G32
    row = f"{token} 0 0 0\n".encode()
    refused(MalformedBody, make.pcd(row, "ascii", 1), PCD)
    refused(MalformedBody, make.ply(row, "ascii", 1), PLY)
    refused(MalformedBody, make.pcd(f"inf 0 0 0\n0 {token} 0 0\n".encode(), "ascii", 2), PCD)


@pytest.mark.parametrize(
    "properties",
    [
        "property list uchar float x\nproperty float y\nproperty float z\n",  # G34
        "property float x\nproperty double y\nproperty uchar z\n",  # G35
        "property float x\nproperty float y\n",
    ],
)
def test_coordinates_that_are_lists_mixed_or_missing_are_a_bad_field(properties, make):
    size = 4 * (5 if "list" in properties else 13 if "uchar" in properties else 8)
    body = b"\x01" + bytes(12) if "list" in properties else bytes(size)
    refused(BadField, make.ply(body * (4 if "list" in properties else 1), "binary_little_endian", 4, properties), PLY)


def test_two_vertex_elements_are_malformed(make):  # G36
    refused(MalformedBody, make.ply(floats(8), "binary_little_endian", 4, extra="element vertex 4\n"), PLY)


def test_the_wrong_byte_order_shows_in_the_values(make):  # G38
    values = make.records(200) + 1.1
    cloud = decode_cloud(make.ply(values.astype(">f4").tobytes(), "binary_little_endian", 200), PLY)
    with pytest.raises(RevisitError) as caught:
        validate_cloud(cloud.points)
    assert caught.value.code in {"OUT_OF_RANGE", "NON_FINITE_POINTS"}


@pytest.mark.parametrize("order", ["little", "big"])
def test_a_list_of_four_billion_is_malformed(order, make):  # G39
    extra = "element face 1\nproperty list uint int vertex_indices\n"
    data = make.ply(floats(4) + b"\xff\xff\xff\xff" + bytes(12), f"binary_{order}_endian", 4, extra=extra)
    refused(MalformedBody, data, PLY)
    refused(MalformedBody, make.ply(make.ascii(make.records(4)) + b"4294967295 1 2\n", "ascii", 4, extra=extra), PLY)


@pytest.mark.parametrize("body", [b"ply\n\n", b"ply\nformat\r\r", b"ply\r", b"ply\nformat ascii 2.0\nend_header\n"])
def test_ply_stumps_are_malformed(body):  # G41
    refused(MalformedBody, body, PLY)


@pytest.mark.parametrize("length", [1, 15, 17, 1599])
def test_a_kitti_scan_has_sixteen_bytes_a_point(length):  # G42
    refused(MalformedBody, bytes(length), KITTI)


def test_pickled_npy_is_unsupported(make):  # G43
    buffer = io.BytesIO()
    np.save(buffer, np.array([{"a": 1}] * 3, dtype=object), allow_pickle=True)
    refused(UnsupportedEncoding, buffer.getvalue(), NPY)


@pytest.mark.parametrize(("descr", "size"), [("<f2", 2), ("<i4", 4), ("|u1", 1), ("<c8", 8), ("|b1", 1)])
def test_npy_types_that_are_no_coordinates_are_a_bad_field(descr, size, make):  # G44
    refused(BadField, make.npy(bytes(120 * 4 * size), descr), NPY)


@pytest.mark.parametrize("shape", ["(120,)", "(120, 2)", "(40, 3, 4)", "(1, 480)", "()"])
def test_npy_shapes_that_are_no_cloud_are_a_bad_field(shape, make):
    size = (
        4 if shape == "()" else 4 * int(np.prod([int(part) for part in shape.strip("()").split(",") if part.strip()]))
    )
    refused(BadField, make.npy(bytes(size), shape=shape), NPY)


@pytest.mark.parametrize(
    "shape", ["(1000000000000, 3)", "(4611686018427387904, 4)", "(-1, 3)", "(True,)", "(1" + "0" * 30 + ", 3)"]
)
def test_impossible_npy_shapes_are_malformed(shape, make):  # G45
    refused(MalformedBody, make.npy(floats(120), shape=shape), NPY)


@pytest.mark.parametrize("descr", ["|S0", "|V0", "|S4", "<U1", "<M8"])
def test_npy_types_without_numbers_are_malformed(descr, make):  # G46
    refused(MalformedBody, make.npy(b"", descr, "(1000000000000,)"), NPY)


def test_structured_long_and_unbalanced_npy_headers_are_malformed(make):  # G47
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(3, dtype=[("x", "<f4"), ("y", "<f4", (2,))]))
    refused(MalformedBody, buffer.getvalue(), NPY)
    refused(MalformedBody, make.npy(floats(120), shape="(120, 4" + "(" * 400), NPY)
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (120, 4), }" + b" " * 20_000 + b"\n"
    data = b"\x93NUMPY\x02\x00" + struct.pack("<I", len(header)) + header + floats(120)
    refused(MalformedBody, data, NPY)
    refused(MalformedBody, b"\x93NUMPY\x03\x00" + bytes(20), NPY)


def test_npz_is_unsupported_whatever_it_holds():  # G48, G49, G50: refused before anything is unpacked
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("../../x.npy", bytes(10**6))
    for media_type in (NPY, KITTI, "application/x-npz", "application/zip"):
        refused(UnsupportedEncoding, buffer.getvalue(), media_type)


@pytest.mark.parametrize("encoding", ["gzip", "zstd"])
def test_bombs_are_too_large(encoding):  # G51
    compress = gzip.compress if encoding == "gzip" else zstandard.ZstdCompressor().compress
    refused(TooLarge, compress(bytes(20 * 2**20)), KITTI, content_encoding=encoding)
    streamed = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(20 * 2**20))
    refused(TooLarge, streamed, KITTI, content_encoding="zstd")


def test_a_bomb_is_stopped_while_it_unpacks():
    bomb = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(400 * 2**20))
    tracemalloc.start()
    try:
        refused(TooLarge, bomb, KITTI, content_encoding="zstd")
        assert tracemalloc.get_traced_memory()[1] < 64 * 2**20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("encoding", ["gzip", "zstd"])
def test_compressed_bodies_end_where_they_should(encoding, make):  # G52
    compress = gzip.compress if encoding == "gzip" else zstandard.ZstdCompressor().compress
    data = compress(make.records().tobytes())
    assert len(decode_cloud(data, KITTI, content_encoding=encoding).points) == 120
    for damaged in (data[:-5], data + b"garbage", data + data, b"no such thing", b""):
        refused(MalformedBody, damaged, KITTI, content_encoding=encoding)


def test_zstd_with_a_huge_window_or_a_dictionary_is_malformed(make):  # G53
    # Frame header descriptor 0 has no content size; window byte 0xa8 says 2 GiB. 0x01 announces a dictionary id.
    refused(MalformedBody, b"\x28\xb5\x2f\xfd\x00\xa8\x01\x00\x00", KITTI, content_encoding="zstd")
    refused(MalformedBody, b"\x28\xb5\x2f\xfd\x01\x00\x07\x01\x00\x00", KITTI, content_encoding="zstd")


@pytest.mark.parametrize("encoding", ["gzip, gzip, gzip", "br", "deflate", "gzip,zstd", "x"])
def test_other_content_encodings_are_unsupported(encoding):  # G54
    refused(UnsupportedEncoding, floats(4), KITTI, content_encoding=encoding)


@pytest.mark.parametrize("media_type", formats.MEDIA_TYPES)
@pytest.mark.parametrize(
    "body",
    [
        pickle.dumps({"points": [1.0, 2.0]}, protocol=2),  # G55
        pickle.dumps([1.0] * 30, protocol=4),
        b"PK\x03\x04" + bytes(60),
        b"\x89PNG\r\n\x1a\n" + bytes(56),  # G56
        b"\xff\xd8\xff\xe0" + bytes(60),
        b"LASF" + bytes(60),  # G58
        b"ASTM-E57" + bytes(56),
        b"\x1f\x8b\x08\x00" + bytes(60),
    ],
)
def test_bodies_of_other_kinds_are_unsupported(body, media_type):
    refused(UnsupportedEncoding, body, media_type)


def test_the_magic_of_one_format_under_the_type_of_another_is_unsupported(make):  # G57
    files = make.valid(make.records())
    for kind, (own, data) in files.items():
        if kind == "kitti":
            continue
        data = b"# .PCD v0.7\n" + data if own == PCD else data
        for media_type in formats.MEDIA_TYPES:
            if media_type != own:
                refused(UnsupportedEncoding, data, media_type)


@pytest.mark.parametrize(
    "name", ["", "application/octet-stream", "text/plain", "application/vnd.las", "multipart/form-data"]
)
def test_unknown_media_types_are_unsupported(name):
    refused(UnsupportedEncoding, floats(4), name)


def test_the_body_limit_is_exact():
    limits = CloudLimits(max_body_bytes=1600)
    assert len(decode_cloud(floats(100), KITTI, limits=limits).points) == 100
    refused(TooLarge, floats(101), KITTI, limits=limits)


@pytest.mark.parametrize(
    "change",
    [
        {"fields": ()},
        {"fields": (formats.PointField("x", 13, 7),)},
        {"fields": (formats.PointField("x", 0, 9),)},
        {"fields": (formats.PointField("x", 0, 7, 0),)},
        {"fields": (formats.PointField("x", 0, 7), formats.PointField("x", 4, 7))},
        {"point_step": 0},
        {"width": 5},
    ],
)
def test_a_packed_cloud_whose_layout_is_impossible_is_malformed(change, make):
    from dataclasses import replace

    packed = replace(formats.pack(make.records(4)[:, :3], make.records(4)[:, 3]), **change)
    refused(MalformedBody, packed.to_bytes(), POINTCLOUD2)


def test_an_unknown_encoding_of_a_packed_cloud_is_unsupported(make):
    from dataclasses import replace

    refused(UnsupportedEncoding, replace(formats.pack(make.records(4)[:, :3]), encoding=7).to_bytes(), POINTCLOUD2)


def test_quantised_clouds_with_impossible_steps_or_sizes_are_malformed(make):
    data = formats.encode_quantised(make.records()[:, :3])
    for step in (0.0, -1.0, float("nan"), float("inf")):
        refused(MalformedBody, data[:8] + struct.pack("<f", step) + data[12:], QUANTISED)
    refused(MalformedBody, data[:4] + struct.pack("<I", 121) + data[8:], QUANTISED)
