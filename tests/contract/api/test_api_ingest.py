"""`revisit ingest` against a running service: resumed, refused, and never another recording for the same one."""

from __future__ import annotations

import json
import shutil

import httpx
import numpy as np
import pytest
from typer.testing import CliRunner

from revisit import Client
from revisit.cli.app import app
from revisit.core.geometry import se3
from revisit.evaluation.datasets import write_kitti
from tests.support.service_world import cloud_points, pose

SCANS = 20
PERIOD_NS = 10**8


def invoke(*arguments, status=0):
    result = CliRunner().invoke(app, ["ingest", *(str(argument) for argument in arguments), "--json"])
    assert result.exit_code == status, result.output
    return result


def figures(result):
    told = json.loads(result.stdout)
    return told["scans_sent"], told["scans_stored"], told["scans_refused"]


def written(folder, clouds=0, step_m=1.0, shift_ns=0, scans=SCANS, detour_m=0.0, turned_rad=0.0):
    """Scans `step_m` apart, the third `detour_m` farther, the first eight turned; of other `clouds`, other points."""
    rows = [
        (
            cloud_points(number + clouds, 500),
            se3.from_yaw(turned_rad * (number < 8), (step_m * number + detour_m * (number == 2), 0.0, 0.0)),
            number * PERIOD_NS + shift_ns,
        )
        for number in range(scans)
    ]
    write_kitti(folder, rows)
    return folder


def damage(recording, numbers):
    files = sorted((recording / "velodyne").iterdir())
    for number in numbers:
        files[number].write_bytes(b"torn")


@pytest.fixture
def recording(tmp_path):
    return written(tmp_path / "drive")


@pytest.fixture
def where(service, request):
    """A map for the test alone, and no waiting."""
    name = "".join(mark if mark.isalnum() else "-" for mark in request.node.name)
    return ("--map", name[-60:].strip("-"), "--grpc", service.grpc, "--no-wait")


def session_of(service, where):
    with Client.grpc(service.grpc) as client:
        return client.get_session(f"maps/{where[1]}/sessions/drive")


@pytest.mark.parametrize("other", [{"shift_ns": 7}, {"clouds": 40}, {"step_m": 0.9}], ids=["times", "clouds", "poses"])
def test_another_recording_is_not_taken_for_the_rest_of_a_session(recording, where, tmp_path, other):
    invoke(recording, *where, "--limit", 12)
    another = written(tmp_path / "other" / "drive", **other)
    refused = invoke(another, *where, status=1).exception
    assert refused.reason == "ALREADY_EXISTS" and "--session NAME" in str(refused)
    assert figures(invoke(recording, *where)) == (8, 20, 0)


@pytest.mark.parametrize(
    "other",
    [
        pytest.param({"shift_ns": 7}, id="times"),
        pytest.param({"step_m": 0.9}, id="poses", marks=pytest.mark.slow),
        pytest.param({"scans": 30}, id="longer"),
        pytest.param({"scans": 12}, id="shorter"),
        pytest.param({"clouds": 40}, id="clouds"),
        pytest.param({"detour_m": 9.0}, id="detour", marks=pytest.mark.slow),
        pytest.param({"turned_rad": 0.1}, id="turned", marks=pytest.mark.slow),
    ],
)
def test_a_finished_session_is_no_success_for_another_recording(recording, where, service, tmp_path, other):
    invoke(recording, *where)
    assert session_of(service, where).state == "FINISHED"
    another = written(tmp_path / "other" / "drive", **other)
    refused = invoke(another, *where, status=1).exception
    assert refused.reason == "SESSION_FINISHED"
    assert "--session NAME" in str(refused) and "DELETE /v1/maps/" in str(refused)
    assert figures(invoke(recording, *where)) == (0, 20, 0)


def test_a_limit_leaves_the_session_open_for_the_rest(recording, where, service):
    part = invoke(recording, *where, "--limit", 12)
    assert figures(part) == (12, 12, 0) and "is not finished: --limit leaves 8 scans out" in part.stderr
    assert session_of(service, where).state == "ACTIVE"
    assert figures(invoke(recording, *where, "--limit", 15)) == (3, 15, 0)
    assert figures(invoke(recording, *where)) == (5, 20, 0)
    assert session_of(service, where).state == "FINISHED"


def test_a_part_that_was_finished_on_purpose_names_the_first_scan_it_lacks(recording, where):
    for _ in range(2):
        assert json.loads(invoke(recording, *where, "--limit", 12, "--finish").stdout)["scans_stored"] == 12
    refused = invoke(recording, *where, status=1).exception
    assert refused.reason == "SESSION_FINISHED" and "ends before 000012.bin of drive" in str(refused)


def test_a_recording_that_was_repaired_behind_a_finished_session_is_no_success(recording, where, tmp_path):
    damaged = tmp_path / "damaged" / "drive"
    shutil.copytree(recording, damaged)
    damage(damaged, (3, 8, 19))
    for run in range(2):
        assert figures(invoke(damaged, *where))[1:] == (17, 0 if run else 3)
    refused = invoke(recording, *where, status=1).exception
    assert refused.reason == "SESSION_FINISHED" and "holds 17 of the 19 scans" in str(refused)


def test_a_session_that_was_finished_empty_is_no_success(recording, where, service):
    with Client.grpc(service.grpc) as client:
        client.finish_session(client.create_session(client.create_map(where[1]), "drive"))
    refused = invoke(recording, *where, status=1).exception
    assert refused.reason == "SESSION_FINISHED" and "ends before 000000.bin" in str(refused)


@pytest.mark.parametrize("by_spool", [False, True], ids=["stream", "spool"])
def test_a_session_in_which_nothing_was_stored_stays_open_and_is_a_failure(
    recording, where, service, tmp_path, by_spool
):
    torn = tmp_path / "torn" / "drive"
    shutil.copytree(recording, torn)
    damage(torn, range(SCANS))
    where += ("--spool", tmp_path / "robot.spool") if by_spool else ()
    result = invoke(torn, *where, status=1)
    assert figures(result) == (0, 0, 20) and "holds no scan" in result.stderr
    assert session_of(service, where).state == "ACTIVE"
    assert figures(invoke(recording, *where)) == (20, 20, 0)


def test_refused_scans_are_told_by_their_file_with_the_reason(recording, where):
    damage(recording, (3, 8))
    times = [f"{number * 0.1:.9f}" for number in range(SCANS)]
    times[12], times[15] = "0.3", "0.5"
    (recording / "times.txt").write_text("\n".join(times))
    result = invoke(recording, *where)
    assert figures(result) == (18, 16, 4)
    told = [line for line in result.stderr.splitlines() if ": refused: " in line]
    assert [line.split(": ")[2:4] for line in told] == [
        ["000003.bin", "MALFORMED_BODY"], ["000008.bin", "MALFORMED_BODY"],
        ["000012.bin", "BAD_FIELD"], ["000015.bin", "BAD_FIELD"],
    ]  # fmt: skip
    assert "before that of the last stored scan" in told[2]
    assert figures(invoke(recording, *where)) == (0, 16, 0)


def test_of_many_refused_scans_the_first_are_told_and_the_others_counted(recording, where):
    damage(recording, range(9))
    told = [line for line in invoke(recording, *where).stderr.splitlines() if ": refused: " in line]
    assert [line.split(": ")[2] for line in told] == [*(f"00000{number}.bin" for number in range(5)), "4 more scans"]


@pytest.mark.parametrize("by_spool", [False, True], ids=["stream", "spool"])
@pytest.mark.parametrize("limit", [10, *(pytest.param(limit, marks=pytest.mark.slow) for limit in (9, 11, 12))])
def test_scans_of_the_same_time_are_resumed_between(recording, where, tmp_path, limit, by_spool):
    times = [f"{number * 0.1:.9f}" for number in range(SCANS)]
    times[10] = times[11] = times[9]
    (recording / "times.txt").write_text("\n".join(times))
    where += ("--spool", tmp_path / "robot.spool") if by_spool else ()
    assert figures(invoke(recording, *where, "--limit", limit)) == (limit, limit, 0)
    assert figures(invoke(recording, *where)) == (SCANS - limit, SCANS, 0)
    assert figures(invoke(recording, *where)) == (0, SCANS, 0)


@pytest.mark.parametrize("by_spool", [False, True], ids=["stream", "spool"])
def test_scans_that_were_left_out_do_not_make_a_second_run_send_others_twice(
    recording, where, service, tmp_path, by_spool
):
    damage(recording, (3, 8, 12))  # left out, they get no number in the session
    where += ("--no-finish", *(("--spool", tmp_path / "robot.spool") if by_spool else ()))
    assert figures(invoke(recording, *where, "--limit", 10)) == (8, 8, 2)
    assert figures(invoke(recording, *where)) == (9, 17, 1)
    assert figures(invoke(recording, *where)) == (0, 17, 0)
    with httpx.Client(base_url=service.http, trust_env=False) as client:
        stored = client.get(f"/v1/maps/{where[1]}/sessions/drive").json()
    # From scan 0 at 0 m to scan 19 at 19 m, never back.
    assert (stored["travelled_m"], int(stored["committed_stamp_ns"])) == (pytest.approx(19.0), 19 * PERIOD_NS)


def test_scans_that_wait_in_the_spool_go_first_and_one_that_is_refused_is_not_sent_again(
    recording, where, service, tmp_path
):
    spool = tmp_path / "robot.spool"
    where += ("--spool", spool)
    invoke(recording, *where, "--limit", 5)
    name = session_of(service, where).name
    with Client.grpc("127.0.0.1:1") as offline, offline.spooled_stream(name, spool) as stream:
        for number in (5, 6):
            stream.send(cloud_points(number, 500), pose(float(number)), number * PERIOD_NS)
        stream.send(np.zeros((300, 3)), pose(7.0), 7 * PERIOD_NS)
    assert figures(invoke(recording, *where)) == (12, 19, 0)


def test_a_name_that_cannot_be_an_id_becomes_one(tmp_path, where):
    result = invoke(written(tmp_path / "fahrt über Köln"), *where)
    assert json.loads(result.stdout)["session"].endswith("/sessions/fahrt-uber-Koln")
    assert "--session fahrt-uber-Koln: made of the name 'fahrt über Köln'" in result.stderr


@pytest.mark.parametrize(
    ("name", "options", "told"),
    [
        ("運転", (), "give one with --session"),
        ("drive", ("--session", "../x"), "--session '../x' cannot be an id"),
        ("drive", ("--map", "mäp"), "--map 'mäp' cannot be an id"),
    ],
)
def test_what_cannot_be_an_id_is_refused_before_anything_is_created(tmp_path, service, name, options, told):
    with Client.grpc(service.grpc) as client:
        before = client.list_maps()
        where = ("--map", "ids-that-are-none", "--grpc", service.grpc)
        assert told in invoke(written(tmp_path / name), *where, *options, status=1).stderr
        assert client.list_maps() == before
