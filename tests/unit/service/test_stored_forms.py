"""Clouds and meshes as they are stored: what comes out is what went in, and damage is noticed."""

from __future__ import annotations

import gzip

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from revisit.core.codec.mesh import Mesh, pack_mesh, unpack_mesh
from revisit.core.errors import BadField, DataLoss, EmptyCloud, MalformedBody, TooLarge, UnsupportedEncoding
from revisit.core.point_columns import same
from revisit.formats import KITTI, PCD, QUANTISED, DecodedCloud, encode_kitti, encode_quantised
from revisit.formats.quantised import MAGIC as QUANTISED_MAGIC
from revisit.service.features.ingest.clouds import EncodedCloud, StoredCloud, accept_cloud, pack_cloud, unpack_cloud
from tests.support.service_world import cloud_points

FLOATS = st.floats(-1e4, 1e4, width=32)


@settings(max_examples=50, deadline=None)
@given(points=arrays(np.float32, st.tuples(st.integers(1, 50), st.just(3)), elements=FLOATS), bright=st.booleans())
def test_a_cloud_is_stored_without_loss(points, bright):
    cloud = StoredCloud(points, {"intensity": points[:, 0].copy()} if bright else {})
    back = unpack_cloud(pack_cloud(cloud))
    np.testing.assert_array_equal(back.points, points)
    assert back.points.dtype == np.float32 and back.points.flags["C_CONTIGUOUS"]
    if bright:
        np.testing.assert_array_equal(back.columns["intensity"], points[:, 0])
    else:
        assert not back.columns


@pytest.mark.parametrize("bright", [False, True])
@pytest.mark.parametrize("coding", [None, "gzip"])
def test_a_quantised_cloud_is_stored_as_it_was_sent(bright, coding):
    points = cloud_points(1)
    sent = encode_quantised(points, {"intensity": np.abs(points[:, 0])} if bright else {})
    body = sent if coding is None else gzip.compress(sent)
    cloud, _ = accept_cloud(EncodedCloud(body, QUANTISED, coding), max_points=1000)
    assert pack_cloud(cloud) == sent
    back = unpack_cloud(sent)
    np.testing.assert_array_equal(back.points, cloud.points)
    assert back.points.flags["C_CONTIGUOUS"]
    assert np.array_equal(back.columns["intensity"], cloud.columns["intensity"]) if bright else not back.columns


def test_a_quantised_cloud_that_is_larger_than_its_numbers_is_packed_anew():
    points = cloud_points(1)
    padded = QUANTISED_MAGIC + bytes(12 * len(points) - 3)
    assert len(pack_cloud(StoredCloud(points, {}, padded))) < len(padded)
    np.testing.assert_array_equal(unpack_cloud(pack_cloud(StoredCloud(points, {}, padded))).points, points)


@pytest.mark.parametrize("damage", [lambda b: b[:8], lambda b: b[:-3], lambda b: b + b"x", lambda b: b[:20] + b[:20]])
def test_a_damaged_quantised_cloud_is_refused(damage):
    with pytest.raises(DataLoss):
        unpack_cloud(damage(encode_quantised(cloud_points(1))))


@pytest.mark.parametrize("damage", [lambda b: b"", lambda b: b[:8], lambda b: b"XXXX" + b[4:], lambda b: b[:-3]])
def test_a_damaged_cloud_or_mesh_is_refused(damage):
    mesh = Mesh(np.ones((3, 3), np.float32), np.ones((3, 3), np.float32), np.array([[0, 1, 2]], np.int32))
    with pytest.raises(DataLoss):
        unpack_cloud(damage(pack_cloud(StoredCloud(cloud_points(1)))))
    with pytest.raises(DataLoss):
        unpack_mesh(damage(pack_mesh(mesh)))


def test_a_mesh_is_stored_to_half_a_millimetre():
    rng = np.random.default_rng(0)
    vertices = rng.uniform(-80.0, 80.0, (500, 3)).astype(np.float32)
    normals = rng.normal(size=(500, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    faces = rng.integers(0, 500, (900, 3)).astype(np.int32)
    back = unpack_mesh(pack_mesh(Mesh(vertices, normals, faces)))
    np.testing.assert_allclose(back.vertices, vertices, atol=0.00051)
    np.testing.assert_allclose(back.normals, normals, atol=0.5 / 127 + 1e-6)
    np.testing.assert_array_equal(back.faces, faces)


def test_an_empty_mesh_is_a_mesh():
    nothing = np.zeros((0, 3), np.float32)
    back = unpack_mesh(pack_mesh(Mesh(nothing, nothing, np.zeros((0, 3), np.int32))))
    assert (len(back.vertices), len(back.faces)) == (0, 0)


def test_points_that_are_dropped_take_their_intensity_with_them():
    points = cloud_points(1).copy()
    points[7] = np.nan
    intensity = np.arange(len(points), dtype=np.float32)
    cloud, report = accept_cloud(DecodedCloud(points, {"intensity": intensity}), max_points=1000)
    assert report.dropped_nonfinite == 1
    np.testing.assert_array_equal(cloud.columns["intensity"], np.delete(intensity, 7))


@pytest.mark.parametrize("wrong", [-0.1, 65_536.0, np.nan, np.inf])
def test_an_intensity_out_of_range_is_refused_as_a_coordinate_is(wrong):
    points, intensity = cloud_points(1), np.ones(300, np.float32)
    intensity[5] = wrong
    with pytest.raises(BadField, match="intensity must be 0 to 65,535"):
        accept_cloud(DecodedCloud(points, {"intensity": intensity}), max_points=1000)
    with pytest.raises(BadField, match="intensity must be"):
        accept_cloud(DecodedCloud(points, {"intensity": intensity[:200]}), max_points=1000)


def test_columns_stay_with_a_cloud_that_is_packed_anew():
    columns = {"ring": np.arange(300, dtype=np.uint16), "time": np.arange(300, dtype=np.int32) * 1000}
    cloud, _ = accept_cloud(DecodedCloud(cloud_points(1), columns), max_points=1000)
    padded = QUANTISED_MAGIC + bytes(10_000)
    back = unpack_cloud(pack_cloud(StoredCloud(cloud.points, cloud.columns, padded)))
    assert same(back.columns, columns)
    np.testing.assert_allclose(back.points, cloud.points, atol=0.00051)


def test_fields_of_a_posted_file_that_no_client_was_asked_for_are_left_as_they_are():
    header = "FIELDS x y z ring\nSIZE 4 4 4 4\nTYPE F F F F\nWIDTH 300\nHEIGHT 1\nPOINTS 300\nDATA binary\n"
    rows = np.column_stack([cloud_points(1), np.full(300, -7.0, np.float32)]).astype("<f4")
    cloud, _ = accept_cloud(EncodedCloud(header.encode() + rows.tobytes(), PCD), max_points=1000)
    assert not cloud.columns


def test_an_encoded_cloud_is_decoded_before_it_is_validated():
    cloud, _ = accept_cloud(EncodedCloud(encode_kitti(cloud_points(1)), KITTI), max_points=1000)
    np.testing.assert_array_equal(cloud.points, cloud_points(1))


@pytest.mark.parametrize(
    ("given_cloud", "error"),
    [
        (EncodedCloud(b"", KITTI), MalformedBody),
        (EncodedCloud(b"x" * 17, KITTI), MalformedBody),
        (EncodedCloud(b"x", "text/plain"), UnsupportedEncoding),
        (DecodedCloud(cloud_points(1, points=301)), TooLarge),
        (DecodedCloud(cloud_points(1, points=99)), EmptyCloud),
        (DecodedCloud(cloud_points(1), {"intensity": np.zeros(5, np.float32)}), BadField),
    ],
)
def test_a_bad_cloud_is_named(given_cloud, error):
    with pytest.raises(error):
        accept_cloud(given_cloud, max_points=300)
