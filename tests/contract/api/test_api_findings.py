"""What the workers find unlikely in a session is told with the session, over both transports, by SDK and CLI."""

from __future__ import annotations

import json
import warnings

import pytest
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.sdk.input_watch import SuspiciousInput
from tests.support.service_world import cloud_points, pose


@pytest.fixture
def drive(client, request):
    """A session of 40 scans, half a metre apart, with a jump of `far` metres in the middle."""

    def make(far: float, session_id: str):
        town = client.create_map(f"f{abs(hash(request.node.name))}")
        session = client.create_session(town, session_id)
        with client.stream(session) as stream:
            for seq in range(1, 41):
                stream.send(cloud_points(seq), pose(0.5 * seq + far * (seq > 20)), seq * 10**8)
        client.finish_session(session)
        for submap in client.list_submaps(session):
            client.wait(submap.operation)
        return session

    return make


def test_a_jump_is_a_finding_of_the_session_with_cause_and_advice(client, drive):
    session = drive(500.0, "jumps")
    (finding,) = client.get_session(session.name).findings
    assert (finding.code, finding.submaps >= 1) == ("pose_jump", True)
    assert "corrected" in finding.cause and "smooth odometry" in finding.advice
    assert "pose_jump" in {flag for submap in client.list_submaps(session) for flag in submap.flags}
    with pytest.warns(SuspiciousInput, match="pose_jump: in .* Likely cause"):
        client.finish_session(session)


def test_a_sound_session_has_no_findings(client, drive):
    session = drive(0.0, "sound")
    assert client.get_session(session.name).findings == ()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        client.finish_session(session)


def test_findings_are_left_out_of_lists(client, drive):
    session = drive(500.0, "listed")
    (listed,) = client.list_sessions(session.name.split("/sessions/")[0])
    assert listed.findings == ()


def test_the_command_inspects_a_stored_session(service, client, drive):
    session = drive(500.0, "stored")
    answer = CliRunner().invoke(app, ["inspect", session.name, "--json", "--http", service.http])
    assert answer.exit_code == 2, answer.output
    document = json.loads(answer.stdout)
    assert document["figures"]["scans"] == 40
    assert [finding["code"] for finding in document["findings"]] == ["pose_jump"]


def test_what_is_neither_a_recording_nor_a_session_is_refused():
    answer = CliRunner().invoke(app, ["inspect", "maps/only"])
    assert answer.exit_code == 1 and "no folder, no bag, and no maps/" in answer.output


def test_a_finished_drive_that_comes_back_to_no_place_says_why_it_has_no_loop(client, drive):
    session = drive(0.0, "onward")
    told = client.get_session(session.name).no_loops
    assert told.code == "NOTHING_TO_COMPARE"
    assert "came back to no place that it had left by 0.5 m" in told.message
    assert [one.no_loops for one in client.list_sessions(session.name.rpartition("/sessions")[0])] == [None]
