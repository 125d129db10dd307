"""Storeys of sessions, the same over REST and gRPC (docs/decisions/0281)."""

from __future__ import annotations

import itertools

import pytest

from revisit.sdk.errors import AlreadyExists, InvalidArgument
from revisit.v1 import loop_closure_pb2, session_pb2
from tests.support.service_world import cloud_points, pose

_numbers = itertools.count(1)


@pytest.fixture
def garage(client):
    return client.create_map(f"garage-{next(_numbers)}", leave_distance_m=0).name


def driven(client, garage, session_id, storey=None):
    """A session of one place, which looks the same on every storey."""
    session = client.create_session(garage, session_id, storey=storey)
    client.wait(client.post_submap(session, "a", cloud_points(1), pose(1.0), 1_000))
    return session


def test_a_session_tells_its_storey(client, garage):
    made = client.create_session(garage, "first", storey="Parking 2")
    assert made.storey == client.get_session(made.name).storey == "Parking 2"
    assert client.finish_session(made).storey == "Parking 2"
    assert client.create_session(garage, "second").storey is None
    assert [session.storey for session in client.list_sessions(garage)] == ["Parking 2", None]


def test_another_storey_is_another_session(client, garage):
    client.create_session(garage, "first", storey="B1")
    assert client.create_session(garage, "first", storey="B1").storey == "B1"
    for other in ("B2", None):
        with pytest.raises(AlreadyExists):
            client.create_session(garage, "first", storey=other)


@pytest.mark.parametrize("bad", [" ", "B1 ", "x" * 65, "B\n1"])
def test_what_names_no_storey_is_refused(client, garage, bad):
    for asked in (
        lambda: client.create_session(garage, "first", storey=bad),
        lambda: client.localize(garage, cloud_points(1), storey=bad),
        lambda: client.search(garage, points=cloud_points(1), storey=bad),
    ):
        with pytest.raises(InvalidArgument) as refused:
            asked()
        assert refused.value.field == "storey"


def test_loops_are_closed_on_one_storey_alone(client, garage):
    for session_id, storey in (("first", "B1"), ("upstairs", "B2"), ("again", "B1"), ("anywhere", None)):
        driven(client, garage, session_id, storey)
    pairs = {(loop.query.split("/")[3], loop.match.split("/")[3]) for loop in client.loop_closures(garage, state="ALL")}
    assert pairs == {("again", "first"), ("anywhere", "first"), ("anywhere", "upstairs"), ("anywhere", "again")}


def test_queries_are_answered_by_storey(client, garage):
    first, second = driven(client, garage, "first", "B1"), driven(client, garage, "second", "B2")
    asked = f"{second.name}/submaps/a"
    assert client.search(garage, submap=asked) == []
    with pytest.raises(InvalidArgument) as refused:
        client.search(garage, submap=asked, storey="B1")
    assert refused.value.field == "storey"
    described = client.get_submap(asked, full=True)
    by_descriptor = {"descriptor": described.descriptor, "model_version": described.model_version}
    for question in ({"points": cloud_points(1)}, by_descriptor):
        assert len(client.search(garage, **question)) == 2
        assert [hit.submap for hit in client.search(garage, storey="B1", **question)] == [f"{first.name}/submaps/a"]
    found = client.localize(garage, cloud_points(1), storey="B1")
    assert (found.session, len(found.candidates), found.on_other_storeys) == (first.name, 1, 1)
    nowhere = client.localize(garage, cloud_points(1), storey="B3")
    assert (nowhere.best, nowhere.candidates, nowhere.on_other_storeys) == (None, (), 2)
    assert client.localize(garage, cloud_points(1)).on_other_storeys == 0


def test_a_search_tells_how_many_submaps_are_on_other_storeys(client, garage):
    driven(client, garage, "first", "B1")
    second = driven(client, garage, "second", "B2")
    request = loop_closure_pb2.SearchSubmapsRequest(parent=garage, submap=f"{second.name}/submaps/a")
    answer = client._transport.call("SearchSubmaps", request)
    assert (answer.searched, answer.on_other_storeys, len(answer.hits)) == (2, 1, 0)


def test_a_client_of_before_says_no_storey_and_reads_answers_as_then():
    """The bytes of messages without a storey are those of before; what it does not know it passes over."""
    assert (
        session_pb2.CreateSessionRequest(parent="maps/m", session_id="s").SerializeToString()
        == b"\n\x06maps/m\x12\x01s"
    )
    told = session_pb2.Session(name="n", storey="B2").SerializeToString()
    assert told == b"\n\x01nZ\x02B2"
    assert loop_closure_pb2.LocalizeRequest(parent="m").SerializeToString() == b"\n\x01m"
