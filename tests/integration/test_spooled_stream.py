"""A robot's spool against the real service: links that are cut, a service that is killed, a robot that is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from revisit import ApiError, Client, Cloud
from revisit.formats import NPY, encode_npy
from revisit.sdk.errors import unreachable
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.spool import Spool, SpoolDisagrees
from tests.faults.proxy import bad_link
from tests.support.live_service import connected, live_service
from tests.support.patience import PATIENCE_S
from tests.support.processes import ForkedService
from tests.support.service_world import cloud_points, pose

ROOT = Path(__file__).resolve().parents[2]
BAD_CLOUD = Cloud(encode_npy(np.full((300, 3), np.nan, np.float32)), NPY)
QUICK = RetryPolicy(attempts=2, base_s=0.01, cap_s=0.05)
STEP_M = 0.5


@pytest.fixture(scope="module")
def service():
    with live_service() as running:
        yield running


@pytest.fixture(params=["rest", "grpc"])
def client(request, service):
    with connected(service, request.param, QUICK) as made:
        yield made


@pytest.fixture
def session(client, request):
    return client.create_session(client.create_map(f"m{abs(hash(request.node.name))}"), "monday")


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    """Reconnect at once: these tests wait for it."""
    monkeypatch.setattr("revisit.sdk.client.RECONNECT", RetryPolicy(attempts=1, base_s=0.01, cap_s=0.1))


def drive(stream, first, last):
    for seq in range(first, last + 1):
        stream.send(cloud_points(seq), pose(STEP_M * seq), seq)


def check_stored(client, session, scans):
    stored = client.get_session(session.name)
    # Every scan is half a metre behind the last one: one lost, repeated or misplaced changes count or distance.
    assert (stored.committed_seq, stored.travelled_m) == (scans, pytest.approx(STEP_M * (scans - 1)))


def test_what_is_sent_through_a_spool_arrives_once_in_order(client, session, tmp_path):
    with client.spooled_stream(session, tmp_path / "spool") as stream:
        drive(stream, 1, 25)
        stream.flush(timeout_s=PATIENCE_S)
        assert (stream.state.pending, stream.state.committed_seq, stream.state.last_stamp_ns) == (0, 25, 25)
        assert len(stream.submaps) == 1
    check_stored(client, session, 25)


def test_a_session_that_the_robot_creates_on_its_way_takes_what_waits(client, request, tmp_path):
    map_id, calls = f"m{abs(hash(request.node.name))}", []

    def prepare():
        calls.append(1)
        if len(calls) == 1:
            raise unreachable("the service", "no link yet")
        client.create_session(client.create_map(map_id), "offline")

    name = f"maps/{map_id}/sessions/offline"
    with client.spooled_stream(name, tmp_path / "spool", prepare=prepare) as stream:
        drive(stream, 1, 3)
        stream.flush(timeout_s=PATIENCE_S)
    check_stored(client, client.get_session(name), 3)
    assert len(calls) == 2


def test_what_is_sent_after_the_spool_ran_empty_arrives_too(client, session, tmp_path):
    with client.spooled_stream(session, tmp_path / "spool") as stream:
        for first, last in ((1, 5), (6, 6), (7, 12)):
            drive(stream, first, last)
            stream.flush(timeout_s=PATIENCE_S)
    check_stored(client, session, 12)


def test_refused_scans_become_dead_letters_and_the_others_arrive(client, session, tmp_path):
    with client.spooled_stream(session, tmp_path / "spool") as stream:
        drive(stream, 1, 3)
        stream.send(BAD_CLOUD, pose(1.75), 3)
        drive(stream, 4, 6)
        stream.flush(timeout_s=PATIENCE_S)
        (dead,) = stream.dead_letters
        assert (dead.seq, dead.reason, dead.stamp_ns) == (4, "UNUSABLE_CLOUD", 3)
    check_stored(client, session, 6)


def test_a_robot_may_start_without_a_link_and_send_when_there_is_one(client, session, tmp_path):
    for offline in (Client.grpc("127.0.0.1:1", retry=QUICK), Client("http://127.0.0.1:1", retry=QUICK)):
        with offline, offline.spooled_stream(session, tmp_path / "spool") as stream:
            first = (stream.state.last_stamp_ns or 0) + 1
            drive(stream, first, first + 4)
            with pytest.raises(TimeoutError, match="scans are not sent"):
                stream.flush(timeout_s=0.3)
            assert stream.error is None
            kept = stream.state
    assert (kept.pending, kept.committed_seq) == (10, None)
    with client.spooled_stream(session, tmp_path / "spool") as stream:
        stream.flush(timeout_s=PATIENCE_S)
    check_stored(client, session, 10)


def test_scans_that_were_stored_but_not_acknowledged_are_not_sent_twice(client, session, tmp_path):
    spool = Spool(tmp_path / "spool", session.name)
    spool.opened(0, "")
    spool.close()
    offline = Client("http://127.0.0.1:1", retry=QUICK)
    with offline, offline.spooled_stream(session, tmp_path / "spool") as stream:
        drive(stream, 1, 5)
    # The service got two scans of this spool, whose robot died before it heard so.
    with client.stream(session) as lost:
        drive(lost, 1, 2)
    with client.spooled_stream(session, tmp_path / "spool") as stream:
        stream.flush(timeout_s=PATIENCE_S)
    check_stored(client, session, 5)


def test_a_session_that_ends_the_sending_is_told_and_the_scans_are_kept(client, session, tmp_path):
    client.finish_session(session)
    with client.spooled_stream(session, tmp_path / "spool") as stream:
        drive(stream, 1, 3)
        with pytest.raises(ApiError, match="SESSION_FINISHED"):
            stream.flush(timeout_s=PATIENCE_S)
        assert stream.error is not None
        drive(stream, 4, 4)
        assert stream.state.pending == 4


def test_a_service_that_lost_acknowledged_scans_is_noticed(client, session, tmp_path):
    spool = Spool(tmp_path / "spool", session.name)
    spool.opened(7, "")
    spool.close()
    with client.spooled_stream(session, tmp_path / "spool") as stream:
        drive(stream, 1, 1)
        with pytest.raises((SpoolDisagrees, ApiError), match=r"acknowledged 7|SEQ_GAP"):
            stream.flush(timeout_s=PATIENCE_S)
        assert stream.state.pending == 1


@pytest.fixture
def real_service(tmp_path):
    running = ForkedService(tmp_path / "home", workers=0)
    yield running
    running.close()


ROBOT = """
import sys
from revisit import Client
from revisit.sdk.retry import RetryPolicy
from tests.support.service_world import cloud_points, pose
target, session, spool = sys.argv[1:]
with Client.grpc(target, retry=RetryPolicy(base_s=0.05)) as client, client.spooled_stream(session, spool) as stream:
    for seq in range((stream.state.last_stamp_ns or 0) + 1, 81):
        stream.send(cloud_points(seq), pose(0.5 * seq), seq)
        print(seq, flush=True)
    stream.flush()
"""


def start_robot(link, session, spool):
    command = [sys.executable, "-c", ROBOT, link.address, session.name, str(spool)]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)


def test_killing_robot_and_service_in_turn_loses_and_repeats_nothing(real_service, tmp_path):
    with bad_link(real_service.grpc_target) as link, Client.grpc(link.address) as client:
        session = client.create_session(client.create_map("town"), "monday")
        robot = start_robot(link, session, tmp_path / "spool")
        for scan in (15, 40):
            while int(robot.stdout.readline()) < scan:
                pass
            if scan == 40:
                real_service.kill()
            os.kill(robot.pid, signal.SIGKILL)
            robot.wait()
            robot = start_robot(link, session, tmp_path / "spool")
            if scan == 40:
                real_service.start()
                link.target = real_service.grpc_target
        assert (robot.communicate(timeout=PATIENCE_S), robot.returncode)[1] == 0
        check_stored(client, session, 80)
    spool = Spool(tmp_path / "spool")
    assert (spool.state.pending, spool.state.committed_seq, spool.state.dead_letters) == (0, 80, 0)
    spool.close()
