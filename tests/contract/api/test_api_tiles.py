"""A version of a map piece by piece, the same over REST and gRPC: tiles, their files, distances, points. Made up."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.formats import decode_cloud, media_type_for_suffix
from revisit.sdk.errors import InvalidArgument, NotFound
from tests.support.service_world import cloud_points, pose

EDGE_M = 51.2
_numbers = itertools.count(1)


@pytest.fixture
def tiled(client):
    """A map of two submaps, 60 m apart, with a version; the name of the version."""
    session = client.create_session(client.create_map(f"tiled-{next(_numbers)}", leave_distance_m=0), "monday")
    for name, x_m in (("a", 5.0), ("b", 65.0)):
        client.wait(client.post_submap(session, name, cloud_points(int(x_m)), pose(x_m), int(x_m)))
    map_name = session.name.partition("/sessions/")[0]
    return client.wait(client.optimise_map(map_name)).result["version"]


def tile_at(client, version, column, row=0):
    return next(one for one in client.map_tiles(version) if one.name.endswith(f".{column}.{row}"))


def test_tiles_cover_what_submaps_may_reach_and_say_where_they_lie(client, tiled):
    tiles = client.map_tiles(tiled)
    assert len(tiles) > 16 and not any(one.made for one in tiles)
    assert all(one.name.startswith(f"{tiled}/tiles/{one.frame}.") for one in tiles)
    middle = tile_at(client, tiled, 0)
    assert (middle.min_m, middle.max_m, middle.submaps) == ((0.0, 0.0), (EDGE_M, EDGE_M), 2)
    assert client.map_tiles(tiled.partition("/versions/")[0]) == tiles


def test_a_tile_is_made_once_and_is_the_same_for_all_who_ask(client, service, tiled):
    tile, before = tile_at(client, tiled, 0), service.world.tiler.made
    first = client.download_tile(tile, "mesh")
    assert client.download_tile(tile.name, "mesh") == first
    assert service.world.tiler.made == before + 1
    assert tile_at(client, tiled, 0).made


@pytest.mark.parametrize("file_format", ["pcd", "ply", "npy"])
def test_points_of_a_tile_lie_in_the_frame_of_the_map(client, tiled, file_format):
    data = client.download_tile(tile_at(client, tiled, 2), file_format)
    points = decode_cloud(data, media_type_for_suffix(f".{file_format}")).points
    np.testing.assert_allclose(points[:, :2].mean(axis=0), [2.5 * EDGE_M, 0.5 * EDGE_M], atol=1e-3)


def test_the_surface_of_a_submap_can_be_had_compressed(client, tiled):
    submap = f"{tiled.partition('/versions/')[0]}/sessions/monday/submaps/a"
    assert client.download(submap, "glb").startswith(b"glTF")


def test_a_tile_with_nothing_in_it_is_a_file_with_nothing_in_it(client, tiled):
    tile = tile_at(client, tiled, 1)
    assert client.download_tile(tile, "glb").startswith(b"glTF")
    assert b"element face 0" in client.download_tile(tile, "mesh")
    assert client.download_tile(tile, "neural") == b""


def test_distances_name_the_version_and_are_unknown_where_nothing_was_seen(client, tiled):
    points = np.array([[10.0, 10.0, 0.4], [10.0, 10.0, -0.2], [10.0, 10.0, 9.0], [60.0, 10.0, 0.1], [9e5, 0.0, 0.0]])
    found = client.map_distances(tiled, points)
    assert tiled.endswith(f"/versions/{found.map_version}") and found.frame == client.map_tiles(tiled)[0].frame
    np.testing.assert_allclose(found.distance_m, [0.4, -0.2, np.nan, np.nan, np.nan], atol=1e-6)
    np.testing.assert_allclose(found.nearest_m, [0.4, 0.2, np.nan, np.nan, np.nan], atol=1e-6)


def test_points_around_a_point_come_the_nearest_first(client, tiled):
    found = client.map_points(tiled, (13.0, 13.0, 0.0), 40.0)
    gaps = np.linalg.norm(found.positions - [13.0, 13.0, 0.0], axis=1)
    assert found.total == len(gaps) == 6 and np.all(np.diff(gaps) >= 0) and gaps.max() <= 40.0
    np.testing.assert_array_equal(found.normals, np.tile([0.0, 0.0, 1.0], (6, 1)))
    one = client.map_points(tiled, (13.0, 13.0, 0.0), 40.0, limit=1)
    assert (one.total, len(one.positions)) == (6, 1)


def test_what_cannot_be_asked_of_a_map_is_told_with_the_field(client, tiled):
    for ask, field in (
        (lambda: client.map_distances(tiled, np.zeros((0, 3))), "points_m"),
        (lambda: client.map_distances(tiled, np.zeros((1001, 3))), "points_m"),
        (lambda: client.map_distances(tiled, [[1e300, 0, 0]]), "points_m"),
        (lambda: client.map_distances(tiled, EDGE_M * np.arange(17)[:, None] * [1.0, 0, 0]), "points_m"),
        (lambda: client.map_points(tiled, (0, 0, 0), 100.5), "within_m"),
        (lambda: client.map_points(tiled, (0, 0, 0), 10.0, limit=2001), "limit"),
        (lambda: client.download_tile(f"{tiled}/tiles/somewhere", "mesh"), "tile"),
    ):
        with pytest.raises(InvalidArgument) as refused:
            ask()
        assert refused.value.field.startswith(field)


def test_what_is_not_there_is_not_found(client, tiled):
    frame = client.map_tiles(tiled)[0].frame
    for ask in (
        lambda: client.map_tiles(f"{tiled}99"),
        lambda: client.download_tile(f"{tiled}/tiles/{frame}.4000.0", "mesh"),
        lambda: client.download_tile(f"{tiled}/tiles/frame-999999.0.0", "mesh"),
        lambda: client.map_distances(tiled, [[0, 0, 0]], frame="frame-999999"),
    ):
        with pytest.raises(NotFound):
            ask()


def test_a_tile_goes_with_a_submap_that_is_deleted(client, service, tiled):
    tile, map_name = tile_at(client, tiled, 0), tiled.partition("/versions/")[0]
    client.download_tile(tile, "mesh")
    client.delete(f"{map_name}/sessions/monday/submaps/b")
    again = tile_at(client, tiled, 0)
    assert (again.made, again.submaps) == (False, 1)
    client.download_tile(tile, "mesh")
    with pytest.raises(NotFound):
        client.download_tile(tile.name.replace(".0.0", ".2.0"), "mesh")


def test_the_command_line_lists_downloads_and_measures(service, client, tiled, tmp_path):
    map_id, out = tiled.split("/")[1], tmp_path / "tile.glb"
    of_map = ["--map", map_id, "--http", service.http]
    tile_id = tile_at(client, tiled, 0).name.rpartition("/")[2]
    listed = CliRunner().invoke(app, ["map", "tiles", *of_map, "--json"])
    assert tile_id in listed.stdout and listed.exit_code == 0
    assert CliRunner().invoke(app, ["map", "tiles", tile_id, "--out", str(out), *of_map]).exit_code == 0
    assert out.read_bytes() == client.download_tile(f"{tiled}/tiles/{tile_id}")
    assert CliRunner().invoke(app, ["map", "tiles", tile_id, *of_map]).exit_code == 1  # nowhere to write it
    points = ("--distance", "10,10,0.4", "--distance", "10,10,9")
    measured = CliRunner().invoke(app, ["map", "tiles", *points, *of_map, "--json"])
    told = json.loads(measured.stdout)
    assert [one["distance_m"] for one in told["distances"]] == [0.4, None]
    assert CliRunner().invoke(app, ["map", "tiles", "--distance", "10,10", *of_map]).exit_code == 1


def test_a_map_is_exported_as_tiles_for_the_web_and_as_squares_for_autoware(service, client, tiled, tmp_path):
    of_map = ["--map", tiled.split("/")[1], "--http", service.http]
    web, squares = tmp_path / "web", tmp_path / "autoware"
    written = CliRunner().invoke(app, ["export", "--format", "3dtiles", "--out", str(web), *of_map])
    assert written.exit_code == 0, written.output
    named = [child["content"]["uri"] for child in json.loads((web / "tileset.json").read_text())["root"]["children"]]
    assert {file.name for file in web.iterdir()} == {"tileset.json", *named}
    assert all((web / uri).read_bytes().startswith(b"glTF") for uri in named) and len(named) >= 2
    written = CliRunner().invoke(app, ["export", "--format", "autoware", "--out", str(squares), *of_map])
    assert written.exit_code == 0, written.output
    described = yaml.safe_load((squares / "pointcloud_map_metadata.yaml").read_text())
    files = {file.name for file in (squares / "pointcloud_map.pcd").iterdir()}
    assert files == described.keys() - {"x_resolution", "y_resolution"} and len(files) >= 2
    assert (squares / "map_projector_info.yaml").read_text() == "projector_type: Local\n"
