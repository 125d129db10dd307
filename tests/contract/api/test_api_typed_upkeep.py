"""Maps, sessions and loops looked after by typing: listed, deleted, decided; and every scan where the map puts it."""

from __future__ import annotations

import json
import threading

import numpy as np
import pytest
from typer.testing import CliRunner

from revisit import Client
from revisit.cli.app import app
from revisit.core.geometry import se3
from revisit.evaluation.datasets import write_kitti
from revisit.formats import npy
from revisit.sdk.errors import NotFound
from revisit.service.features.waiting.freshness import ReadYourWrites
from tests.support.fake_recogniser import FakeRecogniser
from tests.support.patience import PATIENCE_S
from tests.support.service_world import cloud_points, pose
from tests.support.yards import yard


def invoke(*arguments, status=0, answer=None):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments], input=answer)
    assert result.exit_code == status, result.output
    return result.stdout


@pytest.fixture
def town(service, request):
    """The id of a map with two sessions that met."""
    with Client(service.http) as client:
        made = client.create_map(f"typed-{request.node.name[:40]}")
        for day in ("monday", "tuesday"):
            session = client.create_session(made, day)
            client.wait(client.post_submap(session, day[0], cloud_points(7), pose(0.0), 1_000))
    return made.name.partition("/")[2]


def test_maps_and_sessions_are_listed_and_deleted(service, town):
    at = ("--http", service.http)
    assert town in invoke("maps", *at)
    assert town in {one["name"].partition("/")[2] for one in json.loads(invoke("maps", *at, "--json"))}
    shown = invoke("maps", town, *at)
    assert "monday" in shown and "tuesday" in shown
    invoke("delete", f"{town}/monday", *at, answer="n\n", status=1)
    invoke("delete", f"{town}/monday", *at, answer="y\n")
    names = [one["name"] for one in json.loads(invoke("maps", town, *at, "--json"))["sessions"]]
    assert names == [f"maps/{town}/sessions/tuesday"]
    invoke("delete", town, *at, "--yes")
    with Client(service.http) as client, pytest.raises(NotFound):
        client.get_map(town)


def test_a_loop_is_rejected_taken_back_and_accepted_by_its_id(service, town):
    at = ("--map", town, "--http", service.http)
    (loop,) = json.loads(invoke("loops", *at, "--json"))
    explained = ("--submap", "monday/m", "--explain", *at)
    assert "Near misses of monday/m" in invoke("query", *explained)
    assert json.loads(invoke("query", *explained, "--json")) == []
    short = loop["name"].rpartition("/")[2]
    assert short in invoke("loops", *at)
    assert CliRunner().invoke(app, ["loops", short, *at]).exit_code == 1
    assert "REJECTED" in invoke("loops", short, "--reject", *at, "--note", "two halls that look alike")
    assert json.loads(invoke("loops", *at, "--json")) == []
    assert json.loads(invoke("loops", short, "--revert", *at, "--json"))["state"] == "ACCEPTED"
    accepted = invoke("loops", loop["name"], "--accept", "--http", service.http, "--json")
    assert json.loads(accepted)["state"] == "ACCEPTED"


def test_every_scan_of_a_recording_gets_its_pose_in_the_map(service, tmp_path):
    recording = tmp_path / "drive"
    scans = 30
    write_kitti(recording, ((cloud_points(n % 15, 500), pose(float(n)), n * 10**8) for n in range(scans)))
    invoke("ingest", recording, "--map", "scans", "--grpc", service.grpc, "--json")
    out = tmp_path / "scans.tum"
    export = ("export", "--format", "scans", "--map", "scans", "--session", "drive", "--http", service.http)
    invoke(*export, "--recording", recording, "--out", out)
    rows = np.loadtxt(out)
    assert rows.shape == (scans, 8)
    np.testing.assert_allclose(rows[:, 0], np.arange(scans) * 0.1, atol=1e-9)

    other = tmp_path / "other"
    write_kitti(other, ((cloud_points(n, 500), pose(3.0 * n), n * 10**8) for n in range(12)))
    refused = CliRunner().invoke(app, [str(word) for word in (*export, "--recording", other, "--out", out)])
    assert refused.exit_code == 1 and "is not the recording of" in refused.output
    needs = CliRunner().invoke(app, [str(word) for word in (*export, "--out", out)])
    assert needs.exit_code == 1 and "--recording" in needs.output


def test_every_scan_gets_its_pose_in_the_map_where_poses_were_made_of_the_clouds(service, tmp_path):
    pytest.importorskip("kiss_icp", reason="in the extra `kiss-icp`")
    recording, out, scans = tmp_path / "clouds", tmp_path / "scans.tum", 12
    recording.mkdir()
    for n in range(scans):
        seen = se3.apply(se3.inverse(pose(float(n))), yard(1).vertices[::8]).astype(np.float32)
        (recording / f"{n}.npy").write_bytes(npy.encode(seen))
    invoke("ingest", recording, "--odometry", "kiss-icp", "--map", "made", "--grpc", service.grpc)
    export = ("export", "--format", "scans", "--map", "made", "--session", "clouds", "--http", service.http)
    invoke(*export, "--recording", recording, "--odometry", "kiss-icp", "--out", out)
    assert np.loadtxt(out)[-1, 1] == pytest.approx(scans - 1, abs=0.1)


def test_ingest_counts_the_loops_of_the_last_submap_too(service, tmp_path, monkeypatch):
    """The last submap is described, and its loops are still searched for."""
    recording, asked, verify = tmp_path / "drive", threading.Event(), FakeRecogniser.verify
    reached = ReadYourWrites.reached

    def verify_late(*pair):
        assert asked.wait(PATIENCE_S)
        return verify(*pair)

    def reached_for(self, tenant, map_id, wanted):
        if wanted.min_seq:
            asked.set()
        return reached(self, tenant, map_id, wanted)

    for name in ("monday", "tuesday"):
        write_kitti(recording, ((cloud_points(3, 500), pose(float(n)), n * 10**8) for n in range(10)))
        command = ("ingest", recording, "--map", "late", "--session", name, "--grpc", service.grpc, "--json")
        done = json.loads(invoke(*command))
        monkeypatch.setattr(FakeRecogniser, "verify", verify_late)
        monkeypatch.setattr(ReadYourWrites, "reached", reached_for)
    asked.set()
    assert (done["loop_closures"], done["no_loops"]) == (1, None)
