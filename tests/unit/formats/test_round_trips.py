"""Valid files are read exactly, and what the encoders write is what the decoders read."""

from __future__ import annotations

import struct

import numpy as np
import pytest
import zstandard

from revisit import formats
from revisit.core.errors import BadField, OutOfRange


def test_every_format_gives_the_same_points_and_intensities(valid_file, make):
    media_type, data = valid_file
    cloud = formats.decode_cloud(data, media_type)
    expected = make.records()
    assert cloud.points.dtype == np.float32
    np.testing.assert_allclose(cloud.points, expected[:, :3], rtol=0, atol=1e-6)
    np.testing.assert_allclose(cloud.columns["intensity"], expected[:, 3], rtol=0, atol=1e-5)


@pytest.mark.parametrize("media_type", formats.MEDIA_TYPES)
@pytest.mark.parametrize("with_intensity", [True, False])
def test_what_an_encoder_writes_its_decoder_reads(media_type, with_intensity, make):
    encode = {
        formats.KITTI: formats.encode_kitti,
        formats.PCD: formats.encode_pcd,
        formats.PLY: formats.encode_ply,
        formats.NPY: formats.encode_npy,
        formats.POINTCLOUD2: formats.encode_pointcloud2,
        formats.QUANTISED: formats.encode_quantised,
    }[media_type]
    values = make.records()
    cloud = formats.decode_cloud(
        encode(values[:, :3], {"intensity": values[:, 3]} if with_intensity else {}), media_type
    )
    np.testing.assert_allclose(cloud.points, values[:, :3], rtol=0, atol=1e-6)
    if with_intensity:
        np.testing.assert_allclose(cloud.columns["intensity"], values[:, 3], rtol=0, atol=1e-5)
    else:
        assert not any(column.any() for column in cloud.columns.values())


def test_numpy_reads_the_npy_files_that_we_write(tmp_path, make):
    values = make.records()
    (tmp_path / "cloud.npy").write_bytes(formats.encode_npy(values[:, :3], {"intensity": values[:, 3]}))
    np.testing.assert_array_equal(np.load(tmp_path / "cloud.npy", allow_pickle=False), values)


def test_numpy_files_of_both_versions_orders_and_precisions_are_read(tmp_path, make):
    for version in [(1, 0), (2, 0)]:
        for dtype in ["<f4", ">f4", "<f8", ">f8"]:
            for order in "CF":
                path = tmp_path / "cloud.npy"
                with path.open("wb") as file:
                    array = np.asarray(make.records()[:, :3], dtype=dtype, order=order)
                    np.lib.format.write_array(file, array, version=version)
                cloud = formats.decode_cloud(path.read_bytes(), "application/x-npy")
                np.testing.assert_array_equal(cloud.points, make.records()[:, :3])


def test_a_quantised_cloud_is_within_half_a_millimetre_and_smaller():
    rng = np.random.default_rng(3)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 20_000))
    points = np.column_stack([20 * np.cos(angles), 20 * np.sin(angles), rng.uniform(-2, -1, 20_000)]).astype("f4")
    data = formats.encode_quantised(points, {"intensity": np.full(20_000, 0.25, "f4")})
    cloud = formats.decode_cloud(data, formats.QUANTISED)
    assert np.abs(cloud.points - points).max() <= 0.0005 + 2e-6  # float32 of 20 m resolves 2 um
    assert len(data) < 0.5 * 16 * 20_000


def test_quantising_twice_changes_nothing(make):
    values = np.random.default_rng(1).normal(0, 30, (500, 3)).astype("f4")
    once = formats.decode_cloud(formats.encode_quantised(values), formats.QUANTISED).points
    twice = formats.decode_cloud(formats.encode_quantised(once), formats.QUANTISED).points
    np.testing.assert_array_equal(once, twice)


@pytest.mark.parametrize("count", [0, 1, 70_000])
def test_any_intensities_of_a_quantised_cloud_are_summed_up_as_by_the_plain_formula(count):
    levels = np.random.default_rng(count).integers(0, 256, 2 * count, dtype=np.uint8)
    coded = np.ascontiguousarray(levels.reshape(2, count).T).view("<u2").ravel().astype(np.int64)
    summed = np.cumsum(np.where(coded % 2 == 0, coded // 2, -(coded + 1) // 2)) % 2**16
    header = struct.pack("<4sIffI", b"RVQ2", count, 0.25, 0.5, 0)
    body = zstandard.ZstdCompressor().compress(bytes(12 * count) + levels.tobytes())
    cloud = formats.decode_cloud(header + body, formats.QUANTISED)
    assert not cloud.points.any()
    np.testing.assert_array_equal(cloud.columns["intensity"], (0.5 * summed).astype("f4"))


@pytest.mark.parametrize(("value", "error"), [(np.nan, BadField), (np.inf, BadField), (10_001.0, OutOfRange)])
def test_points_that_a_millimetre_grid_cannot_hold_are_not_quantised(value, error):
    with pytest.raises(error):
        formats.encode_quantised(np.array([[value, 0.0, 0.0]], "f4"))


def test_a_quantised_cloud_travels_inside_a_packed_cloud(make):
    values = make.records()
    packed = formats.pack(values[:, :3], {"intensity": values[:, 3]}, formats.Encoding.QUANTISED)
    assert formats.PackedCloud.from_bytes(packed.to_bytes()) == packed
    cloud = formats.decode_cloud(packed.to_bytes(), formats.POINTCLOUD2)
    np.testing.assert_allclose(cloud.points, values[:, :3], atol=1e-6)


def test_a_big_endian_packed_cloud_with_padding_is_read(make):
    values = make.records()
    record = np.zeros(
        len(values),
        dtype={
            "names": list("zyxr"),
            "formats": [">f8", ">f8", ">f8", ">u2"],
            "offsets": [4, 12, 20, 30],
            "itemsize": 40,
        },
    )
    for index, name in enumerate("xyz"):
        record[name] = values[:, index]
    fields = tuple(formats.PointField(name, record.dtype.fields[name][1], 8) for name in "xyz")
    packed = formats.PackedCloud(fields, 40, 60, record.tobytes(), height=2, big_endian=True)
    cloud = formats.decode_cloud(packed.to_bytes(), formats.POINTCLOUD2)
    np.testing.assert_array_equal(cloud.points, values[:, :3])


def test_a_mesh_is_written_with_normals_and_faces():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "f4")
    normals = np.array([[0, 0, 1]] * 3, "f4")
    data = formats.encode_ply_mesh(vertices, normals, np.array([[0, 1, 2]], "i4"))
    np.testing.assert_array_equal(formats.decode_cloud(data, formats.PLY).points, vertices)
    header, _, body = data.partition(b"end_header\n")
    assert b"element face 1\nproperty list uchar int vertex_indices" in header
    assert body[-13:] == struct.pack("<Biii", 3, 0, 1, 2)
    assert struct.unpack("<6f", body[24:48]) == (1, 0, 0, 0, 0, 1)


def test_a_face_may_not_name_a_missing_vertex():
    with pytest.raises(BadField, match="vertex that does not exist"):
        formats.encode_ply_mesh(np.zeros((3, 3)), np.zeros((3, 3)), np.array([[0, 1, 3]]))


def test_a_ply_with_faces_in_front_and_behind_is_read(make):
    values = make.records(6)
    extra = "element face 2\nproperty list uchar int vertex_indices\nproperty uchar red\n"
    faces = struct.pack("<BiiiB", 3, 0, 1, 2, 9) + struct.pack("<BiiiiB", 4, 0, 1, 2, 3, 9)
    data = make.ply(values.tobytes() + faces, "binary_little_endian", 6, extra=extra)
    np.testing.assert_array_equal(formats.decode_cloud(data, formats.PLY).points, values[:, :3])
    ascii_faces = b"3 0 1 2 9\n4 0 1 2 3 9\n"
    data = make.ply(make.ascii(values) + ascii_faces, "ascii", 6, extra=extra)
    np.testing.assert_array_equal(formats.decode_cloud(data, formats.PLY).points, values[:, :3])


def test_pcd_padding_vectors_and_comments_are_skipped(make):
    values = make.records(5)
    record = np.zeros(5, dtype=[("pad", "V4"), ("n", "<f4", 3), ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("p2", "V2")])
    for index, name in enumerate("xyz"):
        record[name] = values[:, index]
    fields = {"FIELDS": "_ normal x y z _", "SIZE": "1 4 4 4 4 1", "TYPE": "U F F F F U", "COUNT": "4 3 1 1 1 2"}
    data = b"# .PCD v0.7\n" + make.pcd(record.tobytes(), "binary", 5, **fields)
    np.testing.assert_array_equal(formats.decode_cloud(data, formats.PCD).points, values[:, :3])


def test_ascii_numbers_may_be_signed_exponential_or_nan(make):
    data = make.pcd(b"+1.5 -2.5e-1 .5 0\nnan NaN -inf 1\n", "ascii", 2)
    points = formats.decode_cloud(data, formats.PCD).points
    np.testing.assert_array_equal(points, np.array([[1.5, -0.25, 0.5], [np.nan, np.nan, -np.inf]], "f4"))


def test_media_type_parameters_case_and_aliases_do_not_matter(make):
    _, data = make.valid(make.records())["ply little"]
    for name in ["model/ply", "Model/PLY; charset=binary", "application/x-ply", "application/vnd.ply"]:
        assert len(formats.decode_cloud(data, name).points) == 120
