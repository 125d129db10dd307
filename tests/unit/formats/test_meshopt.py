"""Compressed meshes: how small they are, and that glTF is kept to. Another reader is in the test of the page."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest

from revisit.core.errors import BadField
from revisit.formats.glb import encode_scene
from revisit.formats.meshopt import along_edges, in_order_of_use


def waves(cells: int, step: float = 0.4):
    """A wavy sheet of so many squares along each side, whose triangles are in no order."""
    x, y = np.meshgrid(np.arange(cells + 1) * step, np.arange(cells + 1) * step, indexing="ij")
    vertices = np.column_stack([x.ravel(), y.ravel(), 0.3 * np.sin(x + 0.7 * y).ravel()])
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    below, beside, across = corner + 1, corner + cells + 1, corner + cells + 2
    faces = np.concatenate([np.column_stack([corner, beside, below]), np.column_stack([below, beside, across])])
    return vertices, np.random.default_rng(0).permutation(faces)


def parts_of(glb):
    """The JSON and the bytes of a file."""
    magic, version, size = struct.unpack_from("<4sII", glb)
    assert (magic, version, size) == (b"glTF", 2, len(glb))
    length, kind = struct.unpack_from("<II", glb, 12)
    assert kind == 0x4E4F534A and length % 4 == 0
    return json.loads(glb[20 : 20 + length]), glb[28 + length :]


def test_a_mesh_takes_at_most_four_bytes_a_triangle():
    vertices, faces = waves(100)
    assert len(encode_scene(vertices, faces)) / len(faces) <= 4.0


def test_a_compressed_file_names_its_extensions_and_lies_within_its_bytes():
    vertices, faces = waves(40)
    told, data = parts_of(encode_scene(vertices, faces, np.array([10.0, 20.0, 30.0])))
    assert set(told["extensionsRequired"]) == {"EXT_meshopt_compression", "KHR_mesh_quantization"}
    for view, accessor in zip(told["bufferViews"], told["accessors"], strict=True):
        packed = view["extensions"]["EXT_meshopt_compression"]
        assert packed["byteOffset"] + packed["byteLength"] <= len(data)
        assert (packed["count"], packed["count"] * packed["byteStride"]) == (accessor["count"], view["byteLength"])
    (node,) = told["nodes"]
    low = vertices.min(axis=0) + [10.0, 20.0, 30.0]
    np.testing.assert_allclose(node["translation"], [low[0], low[2], -low[1]])
    reach = np.array(told["accessors"][0]["max"]) * node["scale"]
    np.testing.assert_allclose(reach, np.ptp(vertices, axis=0), atol=node["scale"][0])


def test_a_mesh_of_many_vertices_has_long_indices_and_one_of_none_has_no_node():
    vertices, faces = waves(260)
    told, _ = parts_of(encode_scene(vertices, faces))
    assert told["accessors"][1]["componentType"] == 5125
    empty, data = parts_of(encode_scene(np.zeros((0, 3)), np.zeros((0, 3), np.int32)))
    assert empty["scenes"] == [{}] and "nodes" not in empty and data == b""


def test_the_walk_over_edges_names_every_triangle_once_and_mostly_neighbours():
    _, faces = waves(30)
    walked = along_edges(faces)
    assert sorted(map(tuple, walked.tolist())) == sorted(map(tuple, faces.tolist()))
    shared = [len(set(one) & set(other)) >= 2 for one, other in zip(walked[1:].tolist(), walked.tolist(), strict=False)]
    assert np.mean(shared) > 0.8


def test_vertices_are_numbered_as_they_are_used_and_the_others_left_out():
    vertices, faces = in_order_of_use(np.arange(15.0).reshape(5, 3), np.array([[4, 2, 0], [0, 2, 3]]))
    np.testing.assert_array_equal(vertices[:, 0], [12.0, 6.0, 0.0, 9.0])
    np.testing.assert_array_equal(faces, [[0, 1, 2], [2, 1, 3]])


@pytest.mark.parametrize(
    ("vertices", "faces"),
    [(np.zeros((3, 2)), [[0, 1, 2]]), (np.full((3, 3), np.nan), [[0, 1, 2]]), (np.zeros((3, 3)), [[0, 1, 3]])],
)
def test_what_is_no_mesh_is_refused(vertices, faces):
    with pytest.raises(BadField):
        encode_scene(vertices, np.array(faces))
