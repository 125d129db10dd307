"""Calls that wait keep nobody out, and end when their client has left, over both transports (P11, P22)."""

from __future__ import annotations

import asyncio
import contextlib
import select
import socket
from urllib.parse import urlsplit

import grpc
import httpx
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc

from revisit import Client
from revisit.sdk.errors import ResourceExhausted
from revisit.sdk.retry import RetryPolicy
from revisit.service.capacity.limits import CallLimits, Share
from revisit.v1 import event_pb2, operation_pb2, operation_pb2_grpc
from tests.support.credentials import a_key
from tests.support.live_service import live_service
from tests.support.patience import PATIENCE_S, eventually
from tests.support.service_world import SESSION, memory_world, posted

SMALL = CallLimits(
    calls=Share("calls", 16, 12, 8),
    waits=Share("waits", 16, 12, 6),
    watches=Share("watches", 16, 12, 6),
)
WAIT_S = 60
SOON_S = 15.0
"""Long before a wait of `WAIT_S` ends by itself."""
GREEDY = ("greedy", "greedier")
ONCE = RetryPolicy(attempts=1)
WAITS = 10
"""Of each key."""
LET_IN = {"greedy": 12, "greedier": 2}
"""Of them, by tenant."""
TOWN = f"maps/{SESSION.map_id}"
WATCH = event_pb2.WatchEventsRequest(parent=TOWN)


@pytest.fixture
def crowded():
    """A service with few slots and no worker; each tenant has an operation that does not end. Slots that another test
    has left may still be taken for a while.
    """
    world = memory_world()
    with live_service(world, SMALL) as running:
        running.working.clear()
        for tenant in (*GREEDY, "modest"):
            post = posted(world, SESSION, tenant, a=1)
            asyncio.run_coroutine_threadsafe(post, running.loop).result(PATIENCE_S)
        yield running


@pytest.fixture
def keys(crowded):
    """Two keys of each tenant."""
    return {tenant: [a_key(crowded.world, tenant).text for _ in range(2)] for tenant in (*GREEDY, "modest")}


def operation_of(crowded, tenant):
    jobs = crowded.world.context.transactions.read(lambda uow: uow.jobs.find(tenant)).result()
    return f"operations/{jobs[0].operation_id}"


class HttpWaits:
    """Requests on connections of their own that wait, and whose answers are not read."""

    def __init__(self, crowded, path, key, count):
        where = urlsplit(crowded.http)
        self._head = f"GET /v1/{path} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {key}\r\n\r\n".encode()
        self._opened = [socket.create_connection((where.hostname, where.port), PATIENCE_S) for _ in range(count)]
        for connection in self._opened:
            connection.sendall(self._head)

    def answered(self):
        """How many have an answer."""
        return len(self._answered())

    def ask_again(self):
        """Those that have an answer ask once more."""
        for connection in self._answered():
            connection.recv(65_536)
            connection.sendall(self._head)

    def _answered(self):
        return select.select(self._opened, [], [], 0.0)[0]

    def close(self):
        for connection in self._opened:
            connection.close()


class RpcWaits:
    """Calls of one connection that wait."""

    def __init__(self, crowded, name, key, count):
        self._channel = grpc.insecure_channel(crowded.grpc, [("grpc.use_local_subchannel_pool", 1)])
        self._stub = operation_pb2_grpc.OperationServiceStub(self._channel)
        self._request = operation_pb2.WaitOperationRequest(name=name, timeout_s=WAIT_S)
        self._metadata = (("authorization", f"Bearer {key}"),)
        self._calls = [self._asked() for _ in range(count)]

    def answered(self):
        """How many have an answer."""
        return sum(call.done() for call in self._calls)

    def ask_again(self):
        """Those that have an answer ask once more."""
        self._calls = [self._asked() if call.done() else call for call in self._calls]

    def _asked(self):
        return self._stub.WaitOperation.future(self._request, metadata=self._metadata)

    def close(self):
        for call in self._calls:
            call.cancel()
        self._channel.close()


def waits_of(crowded, transport, tenant, key, count):
    """So many waits for the tenant's operation; they are left at the end of the block."""
    name = operation_of(crowded, tenant)
    if transport == "grpc":
        return contextlib.closing(RpcWaits(crowded, name, key, count))
    return contextlib.closing(HttpWaits(crowded, f"{name}:wait?timeout_s={WAIT_S}", key, count))


def client_of(crowded, transport, key):
    if transport == "rest":
        return Client(crowded.http, api_key=key, retry=ONCE)
    return Client.grpc(crowded.grpc, api_key=key, retry=ONCE)


def serves(crowded, transport, key):
    """The client reads, waits and watches, and health is told."""
    operation = operation_of(crowded, "modest")
    with client_of(crowded, transport, key) as client:
        assert not client.get_operation(operation).done
        with pytest.raises(TimeoutError):
            client.wait(operation, timeout_s=0.05)
        opened = next(iter(client._transport.watch(WATCH)))
        assert opened.kind == event_pb2.Event.OPENED
    assert httpx.get(f"{crowded.http}/livez", trust_env=False).status_code == 200
    with grpc.insecure_channel(crowded.grpc) as channel:
        assert health_pb2_grpc.HealthStub(channel).Check(health_pb2.HealthCheckRequest()).status == 1
    return True


def so_many_wait(waits, let_in):
    """Whether all but these have been refused. Some may have been because many came before the first was let in."""
    answered = sum(each.answered() for each in waits)
    if answered > len(waits) * WAITS - let_in:
        for each in waits:
            each.ask_again()
    return answered == len(waits) * WAITS - let_in


@pytest.mark.parametrize("transport", ["rest", "grpc"])
def test_two_tenants_that_wait_as_often_as_they_can_keep_no_third_one_out(crowded, keys, transport):
    with contextlib.ExitStack() as held:
        for tenant, let_in in LET_IN.items():
            waits = [held.enter_context(waits_of(crowded, transport, tenant, key, WAITS)) for key in keys[tenant]]
            # One tenant after the other: who is let in is a matter of who comes first.
            eventually(lambda waits=waits, let_in=let_in: so_many_wait(waits, let_in), "they are not let in")
        assert serves(crowded, transport, keys["modest"][0])
        with client_of(crowded, transport, keys[GREEDY[0]][0]) as client:
            assert client.get_map(TOWN), "whoever waits may still ask for something else"


def may_wait(crowded, transport, tenant, key):
    """Whether a wait of the key is let in."""
    try:
        with client_of(crowded, transport, key) as client:
            # So long that a refusal is heard on a busy machine: a wait that nobody has answered is no wait yet.
            client.wait(operation_of(crowded, tenant), timeout_s=1.0)
    except TimeoutError:
        return True
    except ResourceExhausted:
        return False


def all_wait(crowded, transport, waits, key):
    """Whether all of a key's waits are let in. One of them may have been refused, as a look here came before it."""
    waits.ask_again()
    return not may_wait(crowded, transport, "modest", key)


@pytest.mark.parametrize("transport", ["rest", "grpc"])
def test_a_wait_whose_client_has_left_ends(crowded, keys, transport):
    tenant, key = "modest", keys["modest"][1]
    with waits_of(crowded, transport, tenant, key, SMALL.waits.holder) as waits:
        eventually(lambda: all_wait(crowded, transport, waits, key), "the waits do not begin")
    eventually(lambda: may_wait(crowded, transport, tenant, key), "they wait for nobody", timeout_s=SOON_S)


def test_a_list_that_waits_for_a_submap_ends_when_its_client_has_left(crowded, keys):
    key, path = keys["modest"][1], f"maps/{SESSION.map_id}/loopClosures?min_seq={{}}&min_seq_timeout_s={WAIT_S}"
    with client_of(crowded, "rest", key) as client:
        seq = client.list_submaps(f"{TOWN}/sessions/{SESSION.session_id}")[0].seq
    with contextlib.closing(HttpWaits(crowded, path.format(seq), key, SMALL.waits.holder)) as waits:
        eventually(lambda: all_wait(crowded, "rest", waits, key), "they do not begin")
        assert waits.answered() == 0
    eventually(lambda: may_wait(crowded, "rest", "modest", key), "they wait for nobody", timeout_s=SOON_S)
