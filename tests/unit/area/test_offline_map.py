"""Localising in a map file, without a service: made-up yards, seen again from other places."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from revisit.area import AreaMap
from revisit.cli.app import app
from revisit.core.config import PipelineConfig
from revisit.core.errors import DescriptorModelMismatch
from revisit.core.geometry import se3
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import describe
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.evaluation.datasets import write_kitti
from revisit.formats.map_file import FiledSubmap, MapDescription, write_map_file
from tests.support.yards import yard

T_MAP_SUBMAP = [se3.from_yaw(0.7 * n, (300.0 * n, -40.0, 1.0)) for n in range(3)]


def cloud(seed, T_new_old=np.eye(4)):
    """The surfaces of a yard as points, 40 m around."""
    points = se3.apply(T_new_old, yard(seed).vertices).astype(np.float32)
    return points[np.linalg.norm(points, axis=1) < 40.0]


@pytest.fixture(scope="module")
def area_file(tmp_path_factory):
    models, config, rows = load_packaged_models(), PipelineConfig(), []
    for n, T_map_submap in enumerate(T_MAP_SUBMAP):
        submap = Submap.from_cloud(Scan.validated(cloud(n), np.eye(4), 0), config.submap)
        described = describe(submap, models, config)
        neural = described.neural_map.to_blob()
        name = f"maps/yard/sessions/s{n}/submaps/0"
        filed = FiledSubmap(name, 0, n, "frame-1", T_map_submap, np.eye(4), hashlib.sha256(neural).hexdigest())
        rows.append((filed, described.descriptor.vector, neural))
    description = MapDescription(
        "yard", "5", "hash", 0, models.version, 1.0, config.submap.tau, config.submap.stride, {"min_score": None}
    )
    file = tmp_path_factory.mktemp("area") / "yard.zip"
    write_map_file(file, description, rows)
    return file


def test_a_cloud_is_found_in_the_map_where_it_was_taken(area_file):
    T_submap_query = se3.from_yaw(1.1, (4.0, -2.0, 0.0))
    with AreaMap.open(area_file) as area:
        found = area.localize(cloud(1, se3.inverse(T_submap_query)))
        hits = area.search(cloud(1, se3.inverse(T_submap_query)), k=2)
    assert found.best is not None and found.best.submap == "maps/yard/sessions/s1/submaps/0"
    assert hits[0].submap == found.best.submap and len(hits) == 2
    assert found.session == "maps/yard/sessions/s1"
    error = se3.inverse(T_MAP_SUBMAP[1] @ T_submap_query) @ found.in_map.T_map
    assert np.linalg.norm(error[:3, 3]) < 0.1 and se3.rotation_angle(error) < np.radians(0.5)
    assert (found.in_map.frame, found.in_map.map_version) == ("frame-1", 5)


def test_a_cloud_is_found_in_a_map_file_by_typing(area_file, tmp_path):
    np.save(tmp_path / "cloud.npy", cloud(1))
    query = ["query", str(tmp_path / "cloud.npy"), "--file", str(area_file)]
    found = json.loads(CliRunner().invoke(app, [*query, "--json"]).stdout)
    assert found["best"]["submap"] == "maps/yard/sessions/s1/submaps/0"
    assert "in frame-1 (score" in CliRunner().invoke(app, query).stdout
    assert CliRunner().invoke(app, [*query, "--storey", "1"]).exit_code == 1


def test_a_cloud_that_fits_at_two_spots_of_a_drive_is_not_placed(area_file, tmp_path):
    with AreaMap.open(area_file) as area:
        file, one = area.file, area.file.submaps[0]
        twins = [
            replace(one, name=f"{one.name}{n}", ordinal=n, T_odom_submap=pose, T_map_submap=pose)
            for n, pose in enumerate(se3.from_yaw(0.0, (x_m, 0.0, 0.0)) for x_m in (0.0, 32.0))
        ]
        rows = [(twin, file.descriptors[0], file.neural_map(one)) for twin in twins]
        write_map_file(tmp_path / "twins.zip", file.description, rows)
    with AreaMap.open(tmp_path / "twins.zip") as area:
        found = area.localize(cloud(0))
        assert found.best is None
        assert [(one.accepted, one.reason) for one in found.candidates] == [(False, "AMBIGUOUS")] * 2
        assert area.localize(cloud(0), candidates=1).best is None  # the other is compared all the same
        assert area.localize(cloud(0), prior_position_m=(0.0, 0.0, 0.0), radius_m=10.0).best


def test_a_place_that_is_not_in_the_map_or_far_from_the_prior_is_unknown(area_file):
    with AreaMap.open(area_file) as area:
        assert area.localize(cloud(9)).best is None
        elsewhere = area.localize(cloud(1), prior_position_m=(0.0, -40.0, 0.0), radius_m=50.0)
    assert elsewhere.best is None
    assert [one.submap for one in elsewhere.candidates] == ["maps/yard/sessions/s0/submaps/0"]


def test_a_map_of_another_model_is_refused(area_file, tmp_path):
    models = load_packaged_models()
    description = MapDescription("yard", "1", "", 0, "other", 1.0, 10.0, 5.0, {})
    write_map_file(tmp_path / "other.zip", description, [])
    with pytest.raises(DescriptorModelMismatch, match="other"):
        AreaMap.open(tmp_path / "other.zip", models)


def test_a_map_of_rooms_is_opened_though_its_model_is_named_with_its_scale(tmp_path):
    version = load_packaged_models().version
    description = MapDescription("hall", "1", "", 0, f"{version}@scale-0.25", 0.25, 10.0, 5.0, {})
    write_map_file(tmp_path / "hall.zip", description, [])
    with AreaMap.open(tmp_path / "hall.zip") as area:
        assert area.search(cloud(1), k=1) == []


def test_a_recording_is_asked_about_as_it_goes_until_it_is_placed(area_file, tmp_path):
    T_submap_start = se3.from_yaw(1.1, (4.0, -2.0, 0.0))
    poses = [se3.from_yaw(0.0, (1.0 * step, 0.0, 0.0)) for step in range(6)]
    scans = [(cloud(1, se3.inverse(T_submap_start @ pose)), pose, n) for n, pose in enumerate(poses)]
    write_kitti(tmp_path / "drive", scans)
    query = ["query", "--along", str(tmp_path / "drive"), "--file", str(area_file), "--every", "2"]
    told = CliRunner().invoke(app, query)
    assert told.exit_code == 0, told.output
    *before, last = told.stdout.splitlines()
    assert "PLACED" in last and "in frame-1, probability" in last
    assert all("SEVERAL" in line or "UNKNOWN" in line for line in before)
    answers = json.loads(CliRunner().invoke(app, [*query, "--json"]).stdout)
    pose = np.array(answers[-1]["poses"][0]["in_map"]["T_map"])
    travelled = se3.from_yaw(0.0, (answers[-1]["travelled_m"], 0.0, 0.0))
    error = se3.inverse(T_MAP_SUBMAP[1] @ T_submap_start @ travelled) @ pose
    assert np.linalg.norm(error[:3, 3]) < 0.2
    refused = CliRunner().invoke(app, [*query, "--storey", "1"])
    assert refused.exit_code == 1 and "--along" in refused.output
