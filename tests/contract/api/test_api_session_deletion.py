"""A session that is deleted: what goes with it, what stays, and how those who use it notice."""

from __future__ import annotations

import queue

import grpc
import httpx
import pytest

from revisit import Client
from revisit.api.scopes import Scope
from revisit.sdk.errors import NotFound
from revisit.v1 import ingest_pb2, ingest_pb2_grpc
from tests.support.credentials import a_key, bearer
from tests.support.live_service import live_service
from tests.support.patience import PATIENCE_S
from tests.support.service_world import cloud_points, pose


def post(client, session, submap_id, place):
    return client.post_submap(session, submap_id, cloud_points(place), pose(float(place)), place)


@pytest.fixture
def other(client, town):
    """A second session of the same map."""
    return client.create_session(town, "tuesday")


def searched(service, town):
    """How many submaps a search in the index of `town` goes through."""
    query = {"descriptor": [1.0] * 64, "model_version": "fake-1"}
    return httpx.post(f"{service.http}/v1/{town}/submaps:search", json=query, trust_env=False).json()["searched"]


def test_a_deleted_session_takes_its_submaps_and_loops_and_nothing_else(client, session, other, town, service):
    kept = post(client, other, "kept", 1)
    client.wait(kept)
    client.wait(post(client, session, "gone", 1))
    assert [loop.query.rpartition("/")[2] for loop in client.loop_closures(town)] == ["gone"]
    assert searched(service, town) == 2
    client.delete(session)
    for name in (session.name, f"{session.name}/submaps/gone"):
        with pytest.raises(NotFound):
            client.get_submap(name) if "/submaps/" in name else client.get_session(name)
    assert client.loop_closures(town, state="ALL") == []
    assert [found.name for found in client.list_sessions(town)] == [other.name]
    assert [hit.submap for hit in client.search(town, points=cloud_points(1))] == [kept.subject]
    assert searched(service, town) == 1
    with pytest.raises(NotFound):
        client.delete(session)


def test_the_id_of_a_deleted_session_is_free_again(client, session, town):
    client.wait(post(client, session, "a", 1))
    client.delete(session)
    again = client.create_session(town, "monday")
    assert (again.state, again.submap_count) == ("ACTIVE", 0)
    # Other content under the same id, which would be refused if anything were left.
    client.wait(post(client, again, "a", 2))


def test_the_waiting_jobs_of_a_deleted_session_are_dropped_at_once(client, session, service):
    service.working.clear()
    try:
        waiting = [post(client, session, f"s{number}", number) for number in range(3)]
        before = client.status().queued_jobs
        client.delete(session)
        assert client.status().queued_jobs == before - 3
        for operation in waiting:
            ended = client.wait(operation, 1.0)
            assert ended.result == {"outcome": "the submap was deleted"}
    finally:
        service.working.set()


class Silent:
    """A stream that was opened and sends nothing."""

    def __init__(self, service, session):
        self._channel = grpc.insecure_channel(service.grpc)
        self._requests = queue.SimpleQueue()
        self._requests.put(ingest_pb2.StreamScansRequest(open=ingest_pb2.Open(session=session.name)))
        stub = ingest_pb2_grpc.IngestServiceStub(self._channel)
        self.answers = stub.StreamScans(iter(self._requests.get, None), timeout=PATIENCE_S)
        assert next(self.answers).opened.committed_seq == 0

    def close(self):
        self._requests.put(None)
        self._channel.close()


@pytest.mark.parametrize("what", ["session", "map"])
def test_a_silent_stream_of_what_is_deleted_ends_and_others_go_on(client, session, other, town, service, what):
    silent, going_on = Silent(service, session), Silent(service, other)
    client.delete(session if what == "session" else town)
    with pytest.raises(grpc.RpcError) as ended:
        next(silent.answers)
    assert ended.value.code() is grpc.StatusCode.NOT_FOUND
    if what == "session":
        assert going_on.answers.is_active()
    silent.close()
    going_on.close()


def test_a_silent_stream_ends_though_another_gateway_deleted_its_session(client, session, service):
    with live_service(service.world.another_gateway()) as second:
        silent = Silent(second, session)
        client.delete(session)
        with pytest.raises(grpc.RpcError) as ended:
            next(silent.answers)
    assert ended.value.code() is grpc.StatusCode.NOT_FOUND
    silent.close()


def test_only_an_administrator_of_the_tenant_deletes_a_session_and_it_is_written_down(guarded, guarded_http):
    owner, robot, stranger = (
        a_key(guarded.world),
        a_key(guarded.world, scopes=(Scope.INGEST,)),
        a_key(guarded.world, "x"),
    )
    with Client(guarded.http, api_key=owner.text) as client:
        session = client.create_session(client.create_map("audited"), "monday")
        path = f"/v1/{session.name}"
        assert guarded_http.delete(path, headers=bearer(robot)).status_code == 403
        assert guarded_http.delete(path, headers=bearer(stranger)).status_code == 404
        assert client.get_session(session.name).name == session.name
        assert guarded_http.delete(path, headers=bearer(owner)).status_code == 204
    rows = guarded.world.context.transactions.read(lambda uow: uow.audit.since(0, 1000)).result()
    deleted = [(row.tenant, row.actor, row.subject) for row in rows if row.action == "session_deleted"]
    assert deleted == [("acme", f"key {owner.record.key_id}", session.name)]
