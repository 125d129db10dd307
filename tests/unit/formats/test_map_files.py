"""Meshes and grids read back by readers that share nothing with ours: trimesh, Pillow and PyYAML."""

from __future__ import annotations

import io

import numpy as np
import open3d as o3d
import pytest
import trimesh
import yaml
from PIL import Image

from revisit.core.errors import BadField
from revisit.formats import glb, npy, pcd, ply
from revisit.formats.occupancy_grid import FREE, OCCUPIED, UNKNOWN, GridOptions, grid_of

VERTICES = np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 0], [0, 0, 2]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
NORMALS = VERTICES / np.maximum(np.linalg.norm(VERTICES, axis=1, keepdims=True), 1.0)


def test_a_glb_file_holds_the_mesh_with_y_up():
    data = glb.encode_mesh(VERTICES, NORMALS, FACES)
    read = trimesh.load(io.BytesIO(data), file_type="glb", force="mesh", process=False)
    np.testing.assert_allclose(read.vertices, VERTICES[:, [0, 2, 1]] * [1, 1, -1], atol=1e-6)
    np.testing.assert_array_equal(read.faces, FACES)
    assert read.volume == pytest.approx(4.0, rel=1e-5)


def test_the_parts_of_a_glb_file_are_as_long_as_it_says():
    data = glb.encode_mesh(VERTICES, NORMALS, FACES)
    words = np.frombuffer(data[:20], "<u4")
    assert words[0] == 0x46546C67 and words[1] == 2 and words[2] == len(data)
    assert words[3] % 4 == 0 and data[20 + words[3] + 4 : 20 + words[3] + 8] == b"BIN\0"


def test_a_ply_mesh_is_read_by_another_reader():
    read = trimesh.load(io.BytesIO(ply.encode_mesh(VERTICES, NORMALS, FACES)), file_type="ply", process=False)
    np.testing.assert_allclose(read.vertices, VERTICES, atol=1e-6)
    np.testing.assert_array_equal(read.faces, FACES)


IN_UTM = VERTICES + [500123.4567, 5400321.7894, 110.25]


def test_meshes_in_utm_are_exact_to_the_millimetre():
    read = trimesh.load(io.BytesIO(ply.encode_mesh(IN_UTM, NORMALS, FACES)), file_type="ply", process=False)
    np.testing.assert_allclose(read.vertices, IN_UTM, rtol=0, atol=1e-9)
    data = glb.encode_mesh(IN_UTM, NORMALS, FACES)
    read = trimesh.load(io.BytesIO(data), file_type="glb", force="mesh", process=False)
    np.testing.assert_allclose(read.vertices, IN_UTM[:, [0, 2, 1]] * [1, 1, -1], rtol=0, atol=1e-5)


@pytest.mark.parametrize("extension", ["ply", "pcd"])
@pytest.mark.parametrize("columns", [{}, {"intensity": np.linspace(0.0, 1.0, 4)}])
def test_clouds_in_utm_are_exact_to_the_millimetre_and_others_as_small_as_before(tmp_path, extension, columns):
    encode, file = {"ply": ply.encode, "pcd": pcd.encode}[extension], tmp_path / f"cloud.{extension}"
    file.write_bytes(encode(IN_UTM, columns))
    read = o3d.t.io.read_point_cloud(str(file))
    np.testing.assert_allclose(read.point.positions.numpy(), IN_UTM, rtol=0, atol=1e-9)
    near = np.column_stack([VERTICES, *columns.values()])
    assert encode(VERTICES, columns).endswith(b"\n" + near.astype("<f4").tobytes())
    np.testing.assert_array_equal(np.load(io.BytesIO(npy.encode(IN_UTM, columns)))[:, :3], IN_UTM)


@pytest.mark.parametrize(
    ("vertices", "faces"),
    [(VERTICES, FACES + 1), (VERTICES, FACES[:0]), (VERTICES * np.nan, FACES), (VERTICES[:, :2], FACES)],
)
def test_a_mesh_that_is_none_is_refused(vertices, faces):
    with pytest.raises(BadField):
        glb.encode_mesh(vertices, NORMALS, faces)


def test_a_grid_shows_the_wall_the_floor_and_what_nobody_saw():
    grid = grid_of(_yard(), GridOptions(resolution_m=0.5))
    image = np.asarray(Image.open(io.BytesIO(grid.to_pgm())))
    described = yaml.safe_load(grid.to_yaml("yard.pgm"))
    assert described["image"] == "yard.pgm" and described["negate"] == 0
    assert described["resolution"] == 0.5 and described["origin"] == [-5.0, -3.0, 0.0]
    assert described["free_thresh"] < (255 - UNKNOWN) / 255 < described["occupied_thresh"]

    def cell(x, y):
        column, row = (int((value - low) / 0.5) for value, low in zip((x, y), (-5.0, -3.0), strict=True))
        return image[image.shape[0] - 1 - row, column]

    assert cell(2.25, 0.25) == OCCUPIED
    assert cell(-1.75, 0.25) == FREE
    assert cell(4.25, 2.25) == UNKNOWN
    assert cell(-3.75, -1.75) == FREE, "a bridge overhead is no obstacle"


def test_the_ground_may_rise():
    x, y = np.meshgrid(np.arange(0.05, 60.0, 0.1), np.arange(0.05, 4.0, 0.1))
    slope = np.stack([x.ravel(), y.ravel(), 0.1 * x.ravel()], axis=1)
    assert (grid_of(slope, GridOptions(resolution_m=0.5)).cells == FREE).all()


def test_a_grid_without_points_or_beyond_all_bounds_is_refused():
    with pytest.raises(BadField):
        grid_of(np.zeros((0, 3)))
    with pytest.raises(BadField):
        grid_of(np.array([[0.0, 0, 0], [10_000.0, 10_000.0, 0]]))


def _yard() -> np.ndarray:
    """A floor with a wall at x = 2, a bridge in one corner and another corner that nobody saw."""
    x, y = (grid.ravel() for grid in np.meshgrid(np.arange(-4.95, 5.0, 0.1), np.arange(-2.95, 3.0, 0.1)))
    seen = ~((x > 3.0) & (y > 1.0))
    floor = np.stack([x[seen], y[seen], np.zeros(seen.sum())], axis=1)
    along, up = (grid.ravel() for grid in np.meshgrid(np.arange(-2.95, 3.0, 0.1), np.arange(0.0, 2.5, 0.1)))
    wall = np.stack([np.full(len(along), 2.2), along, up], axis=1)
    under = (x < -3) & (y < -1)
    bridge = np.stack([x[under], y[under], np.full(under.sum(), 4.0)], axis=1)
    return np.concatenate([floor, wall, bridge])
