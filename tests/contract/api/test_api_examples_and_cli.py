"""The examples of the documentation and the commands a person types, against a running service."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from revisit import Client
from revisit.cli.app import app
from revisit.core.geometry import se3
from revisit.core.point_columns import COLUMNS
from revisit.evaluation.datasets import KittiRecording, write_kitti
from revisit.formats import decode_cloud, encode_npy, ply
from tests.support.fleet_in_service import fleet_in, fleet_in_two
from tests.support.patience import PATIENCE_S
from tests.support.service_world import cloud_points, pose

ROOT = Path(__file__).resolve().parents[3]


def run_example(name, **environment):
    command = [sys.executable, ROOT / "docs" / "examples" / name]
    variables = {"PYTHONPATH": str(ROOT), **environment}
    result = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False, env=variables)
    assert result.returncode == 0, result.stderr
    return result.stdout


def invoke(*arguments, status=0):
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == status, result.output
    return result.stdout


def code_of(example):
    docstring, _, code = (ROOT / "docs" / "examples" / example).read_text().partition("\n")
    assert docstring.endswith('"""')
    return code.strip()


@pytest.mark.parametrize("name", ["rest_client.py", "grpc_client.py"])
def test_an_example_is_a_client_of_some_twenty_lines(name):
    assert len([line for line in code_of(name).splitlines() if line]) <= 25


@pytest.mark.parametrize("page", ["README.md", "docs/tutorial/first-loop.md"])
def test_a_page_shows_the_rest_example_as_it_runs(page):
    blocks = re.findall(r"^```python\n(.+?)\n```$", (ROOT / page).read_text(), re.MULTILINE | re.DOTALL)
    assert blocks == [code_of("rest_client.py")]


def test_both_examples_see_the_same_yard():
    yard, client, _ = code_of("grpc_client.py").partition("client = ")
    assert client and code_of("rest_client.py").startswith(yard)


def test_the_rest_example_compares_the_two_days(service):
    # What the method makes of the yard is in tests/integration/test_documented_examples.py.
    output = run_example("rest_client.py", REVISIT_HTTP=service.http)
    assert "maps/yard/sessions/tuesday/submaps/start is where maps/yard/sessions/monday/submaps/start was" in output


def test_the_grpc_example_streams_two_drives_that_meet(service):
    run_example("grpc_client.py", REVISIT_GRPC=service.grpc)
    sessions = "maps/streamed-yard/sessions"
    # Loops of this recogniser all have one pose and contradict each other: the example prints those that are accepted.
    pairs = {(one.query, one.match) for one in Client(service.http).loop_closures("streamed-yard", state="ALL")}
    assert any(
        query == f"{sessions}/tuesday/submaps/scans-1-11" and match.startswith(f"{sessions}/monday/submaps/scans-")
        for query, match in pairs
    )


@pytest.mark.skipif(shutil.which("curl") is None, reason="needs curl")
def test_the_curl_example_posts_a_cloud(service, tmp_path):
    page = (ROOT / "docs/how-to/ingest-a-recording.md").read_text()
    (commands,) = [block for block in re.findall(r"```sh\n(.+?)```", page, re.DOTALL) if "curl" in block]
    np.save(tmp_path / "cloud.npy", cloud_points(3))
    variables = {"REVISIT_HTTP": service.http, "PATH": os.environ["PATH"], "no_proxy": "*"}
    done = subprocess.run(
        ["sh", "-e", "-c", commands], cwd=tmp_path, env=variables, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "maps/by-curl/sessions/monday/submaps/s1" in done.stdout


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """30 scans 1 m apart: 0 to 14 m, and back at the start for the other half."""
    folder = tmp_path_factory.mktemp("recordings") / "short"
    scans = ((cloud_points(number % 15, 500), pose(float(number)), number * 10**8) for number in range(30))
    assert write_kitti(folder, scans) == 30
    return folder


def test_a_recording_is_ingested_in_two_goes_and_not_a_third_time(recording, service):
    where = ("--map", "cli", "--grpc", service.grpc, "--json")
    first = json.loads(invoke("ingest", recording, *where, "--limit", 12, "--no-finish"))
    assert (first["scans_sent"], first["scans_stored"], first["scans_refused"]) == (12, 12, 0)
    second = json.loads(invoke("ingest", recording, *where))
    assert (second["scans_sent"], second["scans_stored"]) == (18, 30)
    assert second["described"] == second["submaps"] >= 4
    third = json.loads(invoke("ingest", recording, *where))
    assert (third["scans_sent"], third["submaps"]) == (0, second["submaps"])


def test_a_recording_is_ingested_into_a_new_map_of_the_profile_that_is_asked_for(recording, service):
    where = ("--map", "thesis", "--grpc", service.grpc, "--json")
    done = json.loads(invoke("ingest", recording, *where, "--profile", "paper", "--limit", 12, "--finish"))
    assert done["described"] == done["submaps"] >= 1
    with Client(service.http) as client:
        assert client.get_map("maps/thesis").profile == "paper"
    assert "profile paper" in invoke("maps", "thesis", "--http", service.http)
    again = CliRunner().invoke(app, ["ingest", str(recording), *where, "--profile", "product"])
    assert again.exit_code == 1 and "is in the profile paper" in again.stderr
    unknown = CliRunner().invoke(app, ["ingest", str(recording), "--map", "x", *where[2:], "--profile", "thesis"])
    assert "profile must be one of product, paper" in str(unknown.exception)


def with_columns(recording, folder):
    """The recording as PLY files whose points have every column; the poses beside them as TUM."""
    folder.mkdir()
    poses = []
    for number, scan in enumerate(KittiRecording(recording)):
        order = np.arange(len(scan.points))
        columns = {
            "intensity": np.full(len(order), 10.0 + number, np.float32),
            "ring": (order % 16).astype(np.uint16),
            "time": (order % 100) * 0.001,
            "rgb": np.column_stack([order % 7, order % 5, 40 + order % 3]).astype(np.uint8),
        }
        (folder / f"{number:04d}.ply").write_bytes(ply.encode(scan.points, columns))
        place, turn = scan.T_odom_sensor[:3, 3], se3.to_quaternion(scan.T_odom_sensor)
        poses.append(" ".join(map(str, [1_700_000_000 + 0.1 * number, *place, *turn])))
    (folder / "poses.txt").write_text("\n".join(poses) + "\n")
    return folder


def test_columns_are_sent_where_they_are_wanted_and_exported_with_the_map(recording, service, tmp_path):
    laspy = pytest.importorskip("laspy", reason="in the extra `dev`: reads LAZ")
    bright = with_columns(recording, tmp_path / "bright")
    where = ("--map", "bright", "--grpc", service.grpc, "--json")
    lacking = CliRunner().invoke(app, ["ingest", str(recording), *where, "--session", "dark", "--columns", "ring"])
    assert "ring: 30 of 30 scans have none that can be used" in lacking.stderr
    asked = ("--intensity", "--columns", "rgb,time,ring")
    invoke("ingest", bright, *where, *asked, "--limit", 12, "--no-finish")
    assert json.loads(invoke("ingest", bright, *where, *asked))["scans_stored"] == 30
    unknown = CliRunner().invoke(app, ["ingest", str(bright), *where, "--columns", "speed"])
    assert unknown.exit_code == 1 and "intensity, ring, time, rgb, not 'speed'" in unknown.stderr
    with Client(service.http) as client:
        files = {
            name: np.load(io.BytesIO(client.download(client.list_submaps(f"maps/bright/sessions/{name}")[0], "npy")))
            for name in ("dark", "bright")
        }
    assert (files["dark"].shape[1], files["bright"].shape[1]) == (3, 4)
    at = ("--http", service.http, "--map", "bright")
    for form in ("laz", "ply", "pcd"):
        invoke("export", *at, "--session", "bright", "--format", form, "--out", tmp_path / f"map.{form}")
    found = laspy.read(tmp_path / "map.laz")
    assert set(np.unique(np.rint(found.intensity / 257))) <= set(range(10, 40))
    assert set(found["ring"]) == set(range(16)) and set(np.unique(found.blue)) == {257 * 40, 257 * 41, 257 * 42}
    for form, kind in (("ply", "model/ply"), ("pcd", "application/vnd.pcd")):
        told = decode_cloud((tmp_path / f"map.{form}").read_bytes(), kind, wanted=COLUMNS).columns
        assert told["intensity"].min() >= 9.99 and told["intensity"].max() <= 39.01
        assert told["time"].min() >= 1_700_000_000 and 1_700_000_001 < told["time"].max() <= 1_700_000_003.0
        scan = np.rint(told["intensity"]) - 10  # each has its own, and its points are up to 99 ms behind its stamp
        behind = told["time"] - 1_700_000_000 - 0.1 * scan
        assert behind.min() >= -1e-5 and behind.max() <= 0.099 + 1e-5
        assert (told["rgb"][:, 2] // 4 == 10).all() and told["ring"].max() == 15


def test_drives_on_two_storeys_are_ingested_apart(recording, service, tmp_path):
    where = ("--map", "storeys", "--grpc", service.grpc, "--json")
    for session, storey in (("below", "B1"), ("above", "B2"), ("below-again", "B1")):
        invoke("ingest", recording, *where, "--session", session, "--storey", storey)
    at = ("--http", service.http, "--map", "storeys")
    compared = json.loads(invoke("loops", *at, "--state", "all", "--json"))
    pairs = {(loop["query"].split("/")[3], loop["match"].split("/")[3]) for loop in compared}
    assert {pair for pair in pairs if pair[0] != pair[1]} == {("below-again", "below")}
    assert json.loads(invoke("ingest", recording, *where, "--session", "below"))["scans_sent"] == 0
    other = CliRunner().invoke(
        app, ["ingest", str(recording), *where, "--session", "below", "--storey", "B2"], catch_exceptions=False
    )
    assert other.exit_code != 0 and "has storey B1" in other.stderr

    cloud = tmp_path / "cloud.npy"
    np.save(cloud, cloud_points(3, 500))
    found = json.loads(invoke("query", cloud, *at, "--storey", "B2", "--json"))
    assert {candidate["submap"].split("/")[3] for candidate in found["candidates"]} == {"above"}
    assert found["on_other_storeys"] > 0
    assert "submaps on other storeys were left out" in invoke("query", cloud, *at, "--storey", "B3")


TURNED = "0 0 0.6 0.8"  # the quaternion of a turn about z


@pytest.mark.parametrize(("file", "row"), [("poses.tum", "{seconds} {x} 1 0 {turned}"),
                                           ("graph.g2o", "VERTEX_SE3:QUAT {number} {x} 1 0 {turned}")])  # fmt: skip
def test_clouds_with_a_tum_or_g2o_trajectory_become_a_session(service, tmp_path, file, row):
    for number in range(12):
        (tmp_path / f"{number:03d}.npy").write_bytes(encode_npy(cloud_points(number, 500)))
    rows = [row.format(number=n, seconds=f"100.{n}" if n < 10 else f"101.{n - 10}", x=1.5 * n, turned=TURNED)
            for n in range(12)]  # fmt: skip
    (tmp_path / file).write_text("\n".join(rows))
    where = ("--map", f"with-{file[-3:]}", "--session", "monday", "--grpc", service.grpc, "--json")
    told = json.loads(invoke("ingest", tmp_path, *where))
    assert told["scans_stored"] == 12 and told["described"] == told["submaps"] >= 1
    with Client.grpc(service.grpc) as client:
        first = client.list_submaps(f"maps/with-{file[-3:]}/sessions/monday")[0]
    expected = se3.from_yaw(2 * np.arcsin(0.6), (first.T_odom_submap[0, 3], 0.0, 0.0))  # a recording begins at 0
    np.testing.assert_allclose(first.T_odom_submap, expected, atol=1e-9)
    assert first.T_odom_submap[0, 3] % 1.5 == pytest.approx(0.0, abs=1e-9)
    assert first.stamp_ns // 10**9 == (100 if file == "poses.tum" else 0)


def test_a_spool_is_shown_and_sent_from_the_command_line(service, tmp_path):
    with Client.grpc(service.grpc) as client:
        session = client.create_session(client.create_map("from-spool"), "monday")
    spool = tmp_path / "robot.spool"
    with Client.grpc("127.0.0.1:1") as offline, offline.spooled_stream(session, spool) as stream:
        for number in range(3):
            stream.send(np.zeros((300, 3)) if number == 1 else cloud_points(number), pose(float(number)), number)
    before = json.loads(invoke("spool", spool, "--json"))
    assert (before["session"], before["pending"], before["committed_seq"]) == (session.name, 3, None)
    after = json.loads(invoke("spool", spool, "--send", "--http", service.http, "--json"))
    assert (after["pending"], after["committed_seq"]) == (0, 2)
    assert [(dead["seq"], dead["reason"]) for dead in after["dead_letters"]] == [(2, "UNUSABLE_CLOUD")]
    assert "UNUSABLE_CLOUD" in invoke("spool", spool)


def test_loops_query_and_export_answer_for_an_ingested_recording(recording, service, tmp_path):
    at = ("--http", service.http, "--map", "asked")
    invoke("ingest", recording, *at, "--json")
    found = json.loads(invoke("loops", *at, "--state", "all", "--json"))
    assert all(loop["query"].startswith("maps/asked/sessions/short/submaps/") for loop in found)
    shown = invoke("loops", *at)
    assert "loop closure" in shown and "yaw deg" in shown
    refusal = CliRunner().invoke(app, ["loops", *at, "--session", "nope"])
    assert refusal.exit_code != 0 and "nope" in str(refusal.exception)

    cloud = tmp_path / "cloud.npy"
    np.save(cloud, cloud_points(3, 500))
    assert json.loads(invoke("query", cloud, *at, "--json"))["candidates"]
    without = json.loads(invoke("query", cloud, *at, "--exclude-session", "short", "--level", "0,0,0,1", "--json"))
    assert without["candidates"] == []
    assert "--level is" in CliRunner().invoke(app, ["query", str(cloud), *at, "--level", "1,2"]).stderr
    elsewhere = CliRunner().invoke(app, ["query", "--submap", "short/scans-1-11", *at, "--storey", "B1"])
    assert elsewhere.exit_code != 0 and "--storey is that of a cloud" in elsewhere.stderr
    submap = json.loads(invoke("query", "--submap", "short/scans-1-11", *at, "--k", 2, "--json"))
    assert len(submap) == 2

    lines = invoke("export", *at).splitlines()
    vertices = [line for line in lines if line.startswith("VERTEX_SE3:QUAT ")]
    edges = [line for line in lines if line.startswith("EDGE_SE3:QUAT ")]
    assert len(edges) >= len(vertices) - 1 >= 3
    assert {len(line.split()) for line in vertices} == {9}
    assert {len(line.split()) for line in edges} == {31}
    trajectory = invoke("export", *at, "--format", "tum", "--session", "short").splitlines()
    assert len(trajectory) == len(vertices)
    assert {len(line.split()) for line in trajectory} == {8}
    assert invoke("export", *at, "--format", "csv").startswith("query,match,similarity,score,x,y,z,qx,qy,qz,qw\n")
    invoke("export", *at, "--format", "tum", status=1)


def test_the_doctor_reports_each_part(service, tmp_path):
    arguments = ("doctor", "--home", tmp_path, "--http", service.http, "--grpc", service.grpc, "--json")
    assert [f["check"] for f in json.loads(invoke(*arguments, status=1)) if f["ok"] is False] == ["workers"]
    transactions = service.world.context.transactions
    transactions.write(lambda uow: uow.workers.beat("w1", "fake-1")).result()
    try:
        findings = {finding["check"]: finding for finding in json.loads(invoke(*arguments))}
    finally:
        transactions.write(lambda uow: uow.workers.forget("w1")).result()
    assert findings["workers"]["detail"] == "1 ready"
    assert findings["REST"]["ok"] is True
    assert findings["gRPC"]["ok"] is True
    assert findings["models"]["detail"]
    assert findings["database"]["ok"] is None
    (tmp_path / "revisit.db").write_bytes(b"no database at all" * 100)
    findings = {f["check"]: f for f in json.loads(invoke(*arguments, status=1))}
    assert findings["database"]["ok"] is False


def test_a_command_that_cannot_reach_the_service_says_so_in_one_line():
    command = [sys.executable, "-m", "revisit.cli", "loops", "--http", "http://127.0.0.1:1"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert result.returncode == 1
    # On a busy machine a line before it says that something is under way.
    *_, line = result.stderr.splitlines()
    assert line.startswith("revisit: UNREACHABLE")


def test_help_does_not_load_the_libraries_of_the_method():
    script = (
        "import sys; from typer.testing import CliRunner; from revisit.cli.app import app\n"
        "assert CliRunner().invoke(app, ['--help']).exit_code == 0\n"
        "print([m for m in ('torch', 'numpy', 'grpc', 'fastapi', 'faiss', 'cv2') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_a_map_is_optimised_looked_at_and_brought_back_by_typing(service):
    made = fleet_in(service.world, "typed", 0.3, sessions=2, submaps=20, per_pair=8)
    at = ("--map", made.map_id, "--http", service.http)
    assert "not in the map yet" in invoke("maps", made.map_id, *at[2:])
    first = json.loads(invoke("map", "optimise", *at, "--json"))
    assert (first["version"], first["summary"]["loops_in_map"]) == (1, len(made.right()))
    assert "1 *" in invoke("map", "versions", *at)
    shown = invoke("maps", made.map_id, *at[2:])
    assert "version 1" in shown and f"{len(made.right())} in the map" in shown
    assert json.loads(invoke("maps", made.map_id, *at[2:], "--json"))["map_version"] == 1
    invoke("map", "optimise", *at)
    assert "version 1" in invoke("map", "versions", "--revert", "1", *at)
    assert [one["in_force"] for one in json.loads(invoke("map", "versions", *at, "--json"))] == [False, False, True]


def test_loops_that_the_map_set_aside_are_listed_only_where_they_are_asked_for(service):
    made = fleet_in(service.world, "set-aside", 0.3, sessions=2, submaps=20, per_pair=8)
    at = ("--map", made.map_id, "--http", service.http)
    every = {loop["name"] for loop in json.loads(invoke("loops", *at, "--json"))}
    invoke("map", "optimise", *at)
    assert {loop["name"] for loop in json.loads(invoke("loops", *at, "--json"))} == made.right() < every
    assert {loop["name"] for loop in json.loads(invoke("loops", *at, "--state", "accepted", "--json"))} == every
    assert "SET_ASIDE" not in invoke("loops", *at)
    assert invoke("loops", *at, "--state", "all").count("SET_ASIDE") == len(every - made.right())


def test_a_map_is_merged_into_another_looked_at_and_taken_out_again_by_typing(service, tmp_path):
    made = fleet_in_two(service.world, ("typed-one", "typed-two"), sessions=2, submaps=20, per_pair=0)
    at = ("--http", service.http)
    proposed = invoke("merge", "typed-one", "typed-two", "--dry-run", *at)
    assert "MERGEABLE" in proposed and "1 of 1 sessions join" in proposed
    picture = tmp_path / "merged.png"
    done = json.loads(invoke("merge", "typed-one", "typed-two", "--picture", picture, "--json", *at))
    assert done["verdict"] == "MERGED" and picture.stat().st_size > 10_000
    held = (made.map_id, *at)
    assert "maps/typed-two" in invoke("merge", *held)
    assert "VANISHED" in invoke("merge", "--changes", *held)
    assert json.loads(invoke("merge", "--undo", *held, "--json"))["reverted_at_ns"] > 0
    both = CliRunner().invoke(app, ["merge", "--changes", "--undo", *held])
    assert both.exit_code == 1 and "either --changes or --undo" in both.output
    assert "is in force" in CliRunner().invoke(app, ["merge", "--changes", *held]).output
    far = CliRunner().invoke(app, ["merge", "typed-one", "typed-two", "--near", "900,0,0,0", "--radius", "5", *at])
    assert far.exit_code == 1 and "TOO_FEW_LOOPS" in far.output


def test_a_map_without_submaps_is_refused_by_the_optimise_command(service):
    with Client(service.http) as client:
        client.create_map("nothing-in-it")
    assert (
        "the map holds no submaps"
        in CliRunner().invoke(app, ["map", "optimise", "--map", "nothing-in-it", "--http", service.http]).output
    )


def test_what_happens_in_a_map_is_printed_a_line_each(sqlite_service):
    with Client(sqlite_service.http) as client:
        town = client.create_map("watched")
        for day in ("monday", "tuesday"):
            session = client.create_session(town, day)
            client.wait(client.post_submap(session, day[0], cloud_points(7), pose(0.0), 1_000))
        (loop,) = client.loop_closures(town)
    told = ("watch", "--map", "watched", "--after", 0, "--http", sqlite_service.http)
    assert "describe submap" in invoke(*told, "--count", 1)
    line = invoke(*told, "--kind", "loop_closure", "--count", 1).strip()
    assert line.endswith(f"loop closure accepted: tuesday/t -> monday/m, score {loop.score:.2f}")
    (document,) = invoke(*told, "--kind", "LOOP_CLOSURE", "--count", 1, "--json").splitlines()
    assert json.loads(document)["loop_closure"]["name"] == loop.name
    invoke(*told, "--kind", "weather", status=1)
