"""Another program holds the database (row D02): no answer says stored; once it is free, the repeat is stored once."""

from __future__ import annotations

import sqlite3
import time

import pytest

from revisit import ApiError, Client
from revisit.sdk.retry import RetryPolicy
from revisit.service.engines.local.sqlite import connections, transactions
from tests.support.live_service import live_service
from tests.support.service_world import cloud_points, pose, sqlite_world

ONCE = RetryPolicy(attempts=1)
PATIENCE_MS = 300
"""In place of 5,000, see `test_a_writer_waits_five_seconds_for_the_database`."""


@pytest.fixture
def service(tmp_path, monkeypatch):
    monkeypatch.setitem(connections.WRITER_PRAGMAS, "busy_timeout", PATIENCE_MS)
    world = sqlite_world(tmp_path)
    with live_service(world) as running:
        running.working.clear()
        yield running
    world.context.transactions.close()


def test_a_writer_waits_five_seconds_for_the_database():
    assert connections.WRITER_PRAGMAS["busy_timeout"] == 1000 * transactions.LOCK_TIMEOUT_S == 5000


@pytest.mark.parametrize("transport", ["rest", "grpc"])
def test_a_database_that_stays_locked_refuses_until_it_is_free(service, tmp_path, transport):
    connect = {"rest": lambda: Client(service.http, retry=ONCE), "grpc": lambda: Client.grpc(service.grpc, retry=ONCE)}
    with connect[transport]() as client:
        session = client.create_session(client.create_map("town"), "monday")
        holder = sqlite3.connect(tmp_path / "revisit.db", isolation_level=None)
        holder.execute("BEGIN IMMEDIATE")
        before, began_s = service.stored(), time.monotonic()
        with pytest.raises(ApiError) as refused:
            client.post_submap(session, "a", cloud_points(1), pose(), 1)
        assert time.monotonic() - began_s >= PATIENCE_MS / 1000
        assert (refused.value.reason, refused.value.code) == ("STORAGE_UNCERTAIN", "UNAVAILABLE")
        assert refused.value.retryable and refused.value.retry_after_s > 0
        assert client.get_session(session.name).name == session.name
        assert service.stored() == before
        holder.execute("ROLLBACK")
        holder.close()
        assert client.post_submap(session, "a", cloud_points(1), pose(), 1).state == "QUEUED"
        assert len(client.list_submaps(session)) == 1
