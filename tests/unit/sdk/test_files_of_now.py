"""Clouds and meshes of a map on this machine show what the latest drive left, unless everything is asked for."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from revisit.cli import map_files
from revisit.cli.export import _cloud_of as export_cloud
from revisit.cli.map_files import PlacedSubmap, merged_cloud, merged_mesh
from revisit.formats import encode_pcd
from tests.support.walled_scenes import WALL, seen


@pytest.fixture
def two_days(monkeypatch):
    """Two drives of one place, of which the first saw a wall; what was downloaded of them."""
    maps = {f"maps/yard/sessions/day{one.session}/submaps/a": one for one in (seen(1, WALL), seen(2))}
    asked = []

    def download(name, kind):
        asked.append((name, kind))
        neural_map = maps[name].neural_map
        return neural_map.to_blob() if kind == "neural" else encode_pcd(neural_map.points.positions)

    monkeypatch.setattr(map_files, "Client", lambda http: nullcontext(SimpleNamespace(download=download)))
    placed = [PlacedSubmap(name, one.stamp_ns, one.T_map_submap) for name, one in maps.items()]
    return placed, asked


def walls(points):
    """How many points stand where the wall stood, its foot left out."""
    near = (np.abs(points[:, 0] - WALL[0]) < 1.6) & (np.abs(points[:, 1] - WALL[1]) < 0.2)
    return int((near & (points[:, 2] > -1.2) & (points[:, 2] < 0.5)).sum())


def test_a_cloud_lacks_what_a_later_drive_looked_through(two_days):
    placed, _ = two_days
    now, ever = (merged_cloud("", placed, lambda *_: None, ever=ever).points for ever in (False, True))
    assert walls(now) <= 0.1 * walls(ever) and walls(ever) > 20
    assert len(ever) - len(now) <= 2 * walls(ever)  # its foot goes as well, and nothing else


def test_a_mesh_lacks_what_a_later_drive_looked_through(two_days):
    placed, _ = two_days
    now, ever = (merged_mesh("", placed, lambda *_: None, ever=ever)[0] for ever in (False, True))
    assert walls(now) <= 0.1 * walls(ever) and walls(ever) > 20


def test_of_one_drive_no_neural_map_is_read_for_a_cloud(two_days):
    placed, asked = two_days
    cloud = merged_cloud("", placed[:1], lambda *_: None).points
    assert walls(cloud) > 0 and {kind for _, kind in asked} == {"pcd"}


def test_where_no_drives_are_compared_the_neural_maps_of_those_without_scans_alone_are_read(two_days):
    (before, after), asked = two_days
    both = merged_cloud("", [after, before], lambda *_: None, ever=True).points
    asked.clear()
    cloud = merged_cloud("", [after, replace(before, has_scans=False)], lambda *_: None, ever=True).points
    assert sorted(asked) == sorted([(after.name, "pcd"), (before.name, "neural")])
    assert walls(cloud) > 20 and walls(both) > 20


def test_a_submap_whose_scans_are_gone_has_the_points_of_its_surface_and_tells_what_is_gone(two_days):
    (before, after), asked = two_days
    before, after = replace(before, has_scans=False), replace(after, has_scans=False)
    now, ever = (merged_cloud("", [before, after], lambda *_: None, ever=ever).points for ever in (False, True))
    assert {kind for _, kind in asked} == {"neural"}
    assert walls(now) <= 0.1 * walls(ever) and walls(ever) > 5
    alone = merged_cloud("", [before], lambda *_: None).points
    assert walls(alone) == walls(ever) and 0 < len(alone) <= len(ever)


@pytest.mark.parametrize("made", [merged_cloud, merged_mesh])
def test_the_comparison_of_drives_is_a_stage_of_its_own(two_days, made):
    placed, _ = two_days
    told = []
    made("", placed, lambda *stage: told.append(stage))
    squares = [(done, total) for stage, done, total in told if stage == "squares compared"]
    assert squares == [(done, squares[-1][1]) for done in range(len(squares))] and len(squares) > 1


def test_a_column_that_some_submaps_lack_is_left_out_and_told_and_intensity_is_0_there(two_days, monkeypatch, capsys):
    placed, _ = two_days
    points = np.arange(30.0).reshape(10, 3)
    columns = {"intensity": np.full(10, 9.0, np.float32), "ring": np.arange(10, dtype=np.uint16)}

    def download(name, _kind):
        return encode_pcd(points + 100 * ("day2" in name), columns if "day2" in name else {})

    monkeypatch.setattr(map_files, "Client", lambda http: nullcontext(SimpleNamespace(download=download)))
    cloud = export_cloud("", placed, lambda *_: None, ever=True)
    assert "ring is left out: some submaps have none" in capsys.readouterr().err
    assert sorted(cloud.columns["intensity"]) == [0.0] * 10 + [9.0] * 10 and cloud.columns.keys() == {"intensity"}
    alone = export_cloud("", placed[1:], lambda *_: None, ever=True)
    assert sorted(alone.columns["ring"]) == list(range(10)) and not alone.left_out
