"""Maps as folders: squares for Autoware, tilesets for viewers on the web; read back by readers that are not ours."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml

from revisit.core.errors import MalformedBody
from revisit.core.geometry import geodesy, se3
from revisit.formats import autoware, glb, pcd
from revisit.formats.tileset import TileFile, tileset


def test_every_point_of_a_map_lies_in_the_square_that_the_metadata_names(tmp_path):
    open3d = pytest.importorskip("open3d", reason="in the extra `evaluation`: reads the squares")
    points = np.random.default_rng(1).uniform((-55, -3, -1), (33, 47, 9), (4000, 3))
    corners = []
    for corner, rows in autoware.squares_of(points):
        (tmp_path / autoware.file_of(corner)).write_bytes(pcd.encode(points[rows]))
        corners.append(corner)
    described = yaml.safe_load(autoware.metadata_of(corners))
    assert (described.pop("x_resolution"), described.pop("y_resolution")) == (20.0, 20.0)
    assert described.keys() == {file.name for file in tmp_path.iterdir()}
    read = []
    for name, (x, y) in described.items():
        part = np.asarray(open3d.io.read_point_cloud(str(tmp_path / name)).points)
        assert ((part[:, :2] >= (x, y)) & (part[:, :2] < (x + 20, y + 20))).all() and x % 20 == y % 20 == 0
        read.append(part)
    found = np.concatenate(read)
    assert np.allclose(found[np.lexsort(found.T)], points[np.lexsort(points.T)], atol=1e-5)


def test_a_map_that_is_not_on_earth_says_so_to_autoware():
    assert yaml.safe_load(autoware.LOCAL_PROJECTOR) == {"projector_type": "Local"}


def test_a_map_on_earth_tells_its_origin_to_autoware():
    assert yaml.safe_load(autoware.projector_of((48.1, -11.5, 520.25))) == {
        "projector_type": "LocalCartesian",
        "vertical_datum": "WGS84",
        "map_origin": {"latitude": 48.1, "longitude": -11.5, "altitude": 520.25},
    }


def test_a_tileset_on_earth_has_the_transform_of_its_frame_column_by_column():
    T_ecef_map = geodesy.T_ecef_enu((48.1, 11.5, 520.0)) @ se3.from_yaw(0.3, (4.0, 5.0, 6.0))
    tile = TileFile("0.glb", glb.bounds_of_scene(a_scene((0.0, 0.0, 0.0))[1]))
    root = json.loads(tileset([tile], T_ecef_map))["root"]
    assert np.array_equal(np.reshape(root["transform"], (4, 4)).T, T_ecef_map)
    assert geodesy.geodetic([root["transform"][12:15]])[0] == pytest.approx((48.100045, 11.500054, 526.0), abs=1e-5)
    assert "transform" not in json.loads(tileset([tile]))["root"]


def a_scene(offset) -> tuple[np.ndarray, bytes]:
    random = np.random.default_rng(4)
    vertices = random.uniform((0, 0, 0), (51, 40, 7), (300, 3))
    faces = random.permutation(300).reshape(100, 3)
    return vertices + offset, glb.encode_scene(vertices, faces, np.asarray(offset))


def test_the_box_of_a_tile_is_that_of_its_surface():
    vertices, data = a_scene((102.4, -51.2, 3.0))
    bounds = glb.bounds_of_scene(data)
    assert np.allclose(bounds.low, vertices.min(axis=0), atol=1e-3)
    assert np.allclose(bounds.high, vertices.max(axis=0), atol=0.5)  # positions are whole steps
    assert glb.bounds_of_scene(glb.encode_scene(np.zeros((0, 3)), np.zeros((0, 3), int))) is None
    for damaged in (b"", data[:30], b"glTF" + bytes(40)):
        with pytest.raises(MalformedBody):
            glb.bounds_of_scene(damaged)


def test_the_tiles_of_a_tileset_lie_in_its_box_and_are_finer_than_it():
    tiles = [
        TileFile(f"{number}.glb", glb.bounds_of_scene(a_scene((51.2 * number, 0.0, 0.0))[1])) for number in range(3)
    ]
    described = json.loads(tileset(tiles))
    assert described["asset"] == {"version": "1.1"}
    root = described["root"]
    assert root["refine"] == "ADD" and root["geometricError"] == described["geometricError"] > 0
    assert [child["content"]["uri"] for child in root["children"]] == ["0.glb", "1.glb", "2.glb"]
    assert all(child["geometricError"] == 0 for child in root["children"])
    whole = box(root)
    for child, tile in zip(root["children"], tiles, strict=True):
        low, high = box(child)
        assert np.allclose(low, tile.bounds.low) and np.allclose(high, tile.bounds.high)
        assert (whole[0] <= low + 1e-9).all() and (whole[1] >= high - 1e-9).all()


def box(tile) -> tuple[np.ndarray, np.ndarray]:
    """The lowest and the highest corner, by the definition of 3D Tiles: a middle, and three half axes."""
    values = np.array(tile["boundingVolume"]["box"])
    middle, axes = values[:3], values[3:].reshape(3, 3)
    return middle - np.abs(axes).sum(axis=0), middle + np.abs(axes).sum(axis=0)
