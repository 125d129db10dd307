"""Readings of radio of sessions, the same over REST and gRPC."""

from __future__ import annotations

from dataclasses import replace

import httpx
import pytest

from revisit.core.errors import BadField
from revisit.core.radio import RadioFingerprint
from revisit.sdk.errors import AlreadyExists, ApiError, InvalidArgument, NotFound
from revisit.sdk.radio import RadioReading, hashed_address
from revisit.service.domain import limits
from tests.support.service_world import TENANT, cloud_points, pose

SECOND = 10**9
HALL = {f"aa:bb:cc:00:00:{name:02x}": -50.0 - name for name in range(6)}
READING = RadioReading(100 * SECOND, HALL)


def stored(service, session, kind="radio_readings"):
    _, map_id, _, session_id = session.name.split("/")
    read = service.world.context.transactions.read
    return read(lambda uow: getattr(uow, kind).find(TENANT, map_id=map_id, session_id=session_id)).result()


def test_readings_are_stored_as_hashes_once(client, session, service):
    later = replace(READING, stamp_ns=101 * SECOND)
    assert client.sessions.post_radio(session, [READING]) == 1
    assert client.sessions.post_radio(session, [READING, later]) == 1
    first, second = stored(service, session)
    assert first.heard == second.heard and b"aa:bb" not in first.heard
    parent = session.name.partition("/sessions/")[0].encode()
    heard = {bytes.fromhex(hashed_address(bssid, parent)): dbm for bssid, dbm in HALL.items()}
    assert RadioFingerprint.of_bytes(first.heard).heard == heard


def test_the_key_of_a_fleet_makes_other_hashes_of_the_same_addresses(client, session, service):
    client.sessions.post_radio(session, [READING])
    client.sessions.post_radio(session, [replace(READING, stamp_ns=1)], key="of the fleet")
    upper = RadioReading(2, {bssid.upper().replace(":", "-"): dbm for bssid, dbm in HALL.items()})
    client.sessions.post_radio(session, [upper], key=b"of the fleet")
    with pytest.raises(BadField, match="must not be empty"):
        client.sessions.post_radio(session, [upper], key="")
    first, second, third = stored(service, session)
    assert first.heard != second.heard == third.heard


def test_another_reading_of_the_same_time_is_refused_and_nothing_of_it_stored(client, session, service):
    client.sessions.post_radio(session, [READING])
    other = replace(READING, heard={**HALL, "aa:bb:cc:00:00:00": -90.0})
    with pytest.raises(AlreadyExists):
        client.sessions.post_radio(session, [replace(READING, stamp_ns=5), other])
    assert len(stored(service, session)) == 1


@pytest.mark.parametrize(("change", "field"), [
    ({"access_points": []}, "access_points"),
    ({"access_points": ["aa:bb:cc:00:00:01"], "strengths_dbm": [-50]}, "access_points"),
    ({"access_points": ["0123456789ABCDEF"], "strengths_dbm": [-50]}, "access_points"),
    ({"access_points": ["0123456789abcdef"] * 2, "strengths_dbm": [-50] * 2}, "access_points"),
    ({"strengths_dbm": [-50]}, "strengths_dbm"),
    ({"strengths_dbm": [1] * 6}, "strengths_dbm"),
    ({"strengths_dbm": [-101] * 6}, "strengths_dbm"),
    ({"stamp_ns": -1}, "stamp_ns"),
])  # fmt: skip
def test_a_reading_out_of_bounds_is_refused(client, session, service, change, field):
    with pytest.raises(InvalidArgument) as refused:
        client.sessions._ask("PostRadio", parent=session.name, readings=[{**READING.message(b"k"), **change}])
    assert field in (refused.value.field or "")
    assert stored(service, session) == []


def test_a_strength_that_no_message_holds_is_refused(service, session):
    """Over HTTP a number may be any: it is refused before it becomes a field of 32 bits."""
    readings = [{"stamp_ns": 5, "access_points": ["0" * 16], "strengths_dbm": [2**40]}]
    answered = httpx.post(f"{service.http}/v1/{session.name}/radio", json={"readings": readings})
    assert answered.status_code == 422 and "strengths_dbm.0" in answered.text


def test_readings_are_bounded(client, session, monkeypatch):
    many = [replace(READING, stamp_ns=one) for one in range(int(limits.READINGS.most) + 1)]
    with pytest.raises(InvalidArgument):
        client.sessions._ask("PostRadio", parent=session.name, readings=[one.message(b"k") for one in many])
    assert client.sessions.post_radio(session, many) == len(many)
    monkeypatch.setattr(limits, "READINGS_OF_SESSION", len(many))
    assert client.sessions.post_radio(session, many) == 0
    with pytest.raises(ApiError, match="at most 101 readings"):
        client.sessions.post_radio(session, [replace(READING, stamp_ns=9_999)])


def test_a_submap_keeps_what_was_heard_while_it_was_driven(client, session, service):
    other = RadioReading(300 * SECOND, {"dd": -40.0})
    client.sessions.post_radio(session, [READING, replace(READING, stamp_ns=103 * SECOND), other])
    for number, stamp in enumerate((101, 200)):
        client.wait(
            client.post_submap(session, f"s{number}", cloud_points(number), pose(50.0 * number), stamp * SECOND)
        )
    near, far = stored(service, session, "submaps")
    assert near.radio == stored(service, session)[0].heard and far.radio is None


def test_readings_go_with_their_session(client, town, service):
    gone = client.create_session(town, "gone")
    client.sessions.post_radio(gone, [READING])
    client.delete(gone)
    with pytest.raises(NotFound):
        client.sessions.post_radio(gone, [READING])
    assert stored(service, gone) == []
