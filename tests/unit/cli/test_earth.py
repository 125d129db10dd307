"""A map on earth in a projected reference system."""

from __future__ import annotations

import json
import sys

import laspy
import numpy as np
import pytest
from typer.testing import CliRunner

import revisit.cli.earth as earths
from revisit.cli import map_files
from revisit.cli.app import app
from revisit.cli.map_files import MergedCloud, PlacedSubmap
from revisit.core.errors import BadField
from revisit.core.geometry import geodesy, se3
from revisit.sdk.earth import OnEarth
from revisit.sdk.resources import MapChange

pytest.importorskip("pyproj", reason="in the extra `crs`")

TURNED = se3.from_yaw(0.3, (20.0, -7.0, 1.5))


def test_the_middle_of_a_zone_of_utm_is_500_km_east_and_true_to_its_scale():
    earth = OnEarth((0.0, 9.0, 0.0), np.eye(4))
    points = np.array([[0.0, 0.0, 0.0], [0.0, 1000.0, 0.0], [0.0, 0.0, 5.0]])
    at = earth.projected(points, 25832)
    assert at[0] == pytest.approx([500_000.0, 0.0, 0.0], abs=1e-3)
    assert np.linalg.norm(at[1, :2] - at[0, :2]) == pytest.approx(999.6, abs=1e-2), "scale of UTM: 0.9996"
    assert at[2] - at[0] == pytest.approx([0.0, 0.0, 5.0], abs=1e-3)


def test_a_turned_map_keeps_its_shape():
    points = np.random.default_rng(2).uniform(-200.0, 200.0, (50, 3)) * (1.0, 1.0, 0.1)
    at = OnEarth((48.1, 11.5, 520.0), TURNED).projected(points, 25832)
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    assert np.abs(np.linalg.norm(at[:, None] - at[None], axis=2) - apart).max() < 0.25
    # 11.5 degrees lie 2.5 east of the middle of zone 32, where the grid is turned by 1.86 degrees.
    north = OnEarth((48.1, 11.5, 520.0), np.eye(4)).projected(np.array([[0.0, 0.0, 0.0], [0.0, 100.0, 0.0]]), 25832)
    east, along = (north[1] - north[0])[:2]
    assert np.degrees(np.arctan2(east, along)) == pytest.approx(-2.5 * np.sin(np.radians(48.1)), abs=0.02)


@pytest.mark.parametrize("latitude_deg", [-60.0, 0.0, 48.1, 75.0])
def test_a_pose_of_the_map_has_a_place_and_a_heading_on_earth(latitude_deg):
    earth = OnEarth((latitude_deg, 11.5, 520.0), TURNED)
    T_map = se3.inverse(TURNED) @ se3.from_yaw(np.radians(90.0 - 30.0), (300.0, -120.0, 4.0))
    at = earth.pose(T_map)
    assert at.heading_deg == pytest.approx(30.0, abs=0.02), "the meridians of 300 m are not parallel"
    where = np.array([[at.latitude_deg, at.longitude_deg, at.altitude_m]])
    assert geodesy.enu((latitude_deg, 11.5, 520.0), where)[0] == pytest.approx([300.0, -120.0, 4.0], abs=1e-3)


def test_a_drive_and_a_change_that_cross_the_date_line_are_cut_there():
    earth = OnEarth((-17.0, 179.9999, 10.0), np.eye(4))
    drive = [
        PlacedSubmap(f"maps/m/sessions/s/submaps/{n}", n, se3.from_yaw(0.0, (x_m, 2.0, 0.0)))
        for n, x_m in enumerate((0.0, 8.0, 16.0, 5.0))
    ]
    (line,) = json.loads(earths.as_geojson(drive, earth))["features"]
    parts = line["geometry"]["coordinates"]
    assert line["geometry"]["type"] == "MultiLineString" and [len(part) for part in parts] == [3, 3, 2]
    assert [np.sign([at[0] for at in part]).tolist() for part in parts] == [[1.0] * 3, [-1.0] * 3, [1.0] * 2]
    assert [abs(parts[0][-1][0]), abs(parts[1][0][0])] == [180.0, 180.0]
    change = MapChange(kind="APPEARED", frame="f", centre_m=(10.0, 0.0, 0.0), extent_m=(8.0, 4.0, 2.0))
    (box,) = earths.changes_as_geojson([change], {"f": earth})["features"]
    rings = [np.array(part[0]) for part in box["geometry"]["coordinates"]]
    assert box["geometry"]["type"] == "MultiPolygon" and all((ring[0] == ring[-1]).all() for ring in rings)
    wide = [np.ptp(ring[:, 0]) * 111_320 * np.cos(np.radians(17.0)) for ring in rings]
    assert sum(wide) == pytest.approx(8.0, abs=0.05)


def test_north_is_0_degrees_also_where_numbers_round():
    earth = OnEarth((48.1, 11.5, 520.0), np.eye(4))
    for tenths_of_pi in np.linspace(-1e-16, 1e-16, 9):
        heading_deg = earth.pose(se3.from_yaw(np.pi / 2 + tenths_of_pi, (0.0, 0.0, 0.0))).heading_deg
        assert 0.0 <= heading_deg < 360.0


@pytest.mark.parametrize(
    ("epsg", "words"),
    [
        (1, "no reference system"),
        (4326, "no projected"),
        (2263, "no projected"),
        (5972, "heights of its own, .*give EPSG:25832"),
        (2049, "to the west and the south"),
    ],
)
def test_what_is_no_projected_system_of_east_and_north_in_metres_is_refused(epsg, words):
    with pytest.raises(BadField, match=words):
        OnEarth((48.1, 11.5, 520.0), np.eye(4)).projected(np.zeros((1, 3)), epsg)


def test_a_system_of_another_side_of_the_earth_is_refused():
    with pytest.raises(BadField, match="does not reach"):
        OnEarth((0.0, -81.0, 0.0), np.eye(4)).projected(np.zeros((1, 3)), 25832)


@pytest.mark.parametrize("form", ["laz", "copc"])
def test_a_cloud_is_exported_in_the_system_and_names_it(monkeypatch, tmp_path, form):
    """Read back by laspy, which takes the system from the file."""
    points, earth = np.random.default_rng(1).uniform(0.0, 50.0, (200, 3)), OnEarth((48.1, 11.5, 520.0), TURNED)
    placed = [PlacedSubmap("maps/site/sessions/a/submaps/1", 0, np.eye(4), "f")]
    monkeypatch.setattr(map_files, "placed_submaps", lambda *_: placed)
    monkeypatch.setattr(map_files, "merged_cloud", lambda *_, ever: MergedCloud(points))
    monkeypatch.setattr(earths, "frame_on_earth", lambda *_: earth)
    out = tmp_path / "site.laz"
    asked = ["export", "--map", "site", "--format", form, "--out", str(out), "--epsg"]
    assert CliRunner().invoke(app, [*asked, "25832"]).exit_code == 0
    stored = laspy.read(out)
    assert stored.header.parse_crs().to_epsg() == 25832
    order, expected = (np.lexsort(np.round(one, 2).T) for one in (stored.xyz, earth.projected(points, 25832)))
    assert np.abs(stored.xyz[order] - earth.projected(points, 25832)[expected]).max() < 0.001
    monkeypatch.setattr(map_files, "merged_cloud", lambda *_, ever: pytest.fail("hours of a large map"))
    refused = CliRunner().invoke(app, [*asked, "4326"])
    assert refused.exit_code == 1 and "no projected system" in refused.output


def test_copc_without_its_package_says_so_before_the_cloud_is_made(monkeypatch, tmp_path):
    placed = [PlacedSubmap("maps/site/sessions/a/submaps/1", 0, np.eye(4), "f")]
    monkeypatch.setattr(map_files, "placed_submaps", lambda *_: placed)
    monkeypatch.setattr(map_files, "merged_cloud", lambda *_, ever: pytest.fail("hours of a large map"))
    monkeypatch.setitem(sys.modules, "copclib", None)
    monkeypatch.delitem(sys.modules, "revisit.formats.copc", raising=False)
    monkeypatch.delattr("revisit.formats.copc", raising=False)
    refused = CliRunner().invoke(app, ["export", "--map", "site", "--format", "copc", "--out", str(tmp_path / "a.laz")])
    assert refused.exit_code == 1 and "revisit-loops[crs]" in refused.output.replace("\n", "")


def test_without_the_package_the_error_names_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyproj", None)
    with pytest.raises(ModuleNotFoundError, match="pyproj"):
        OnEarth((48.1, 11.5, 520.0), np.eye(4)).projected(np.zeros((1, 3)), 25832)
