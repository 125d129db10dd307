"""Whoever opens calls that last keeps nobody else out (P11, P22): each kind of call has places of its own."""

from __future__ import annotations

import asyncio
import contextlib
import socket

import grpc
import httpx
import pytest
from google.rpc import error_details_pb2, status_pb2
from grpc_health.v1 import health_pb2, health_pb2_grpc

from revisit.service.edge.connections import UnauthenticatedConnections
from revisit.service.grpc import errors, open_connections
from revisit.service.grpc.server import create_server
from revisit.v1 import loop_closure_pb2, loop_closure_pb2_grpc, map_pb2, map_pb2_grpc
from tests.support.credentials import a_key
from tests.support.http2 import OPENING, call_headers
from tests.support.live_service import live_service
from tests.support.patience import PATIENCE_S
from tests.support.service_world import SESSION, memory_world, open_session

WATCHES = 300
CONNECTIONS = 3


@pytest.fixture(scope="module")
def crowded():
    """A service with two tenants, each with a map."""
    world = memory_world()
    with live_service(world) as running:
        for tenant in ("greedy", "other"):
            asyncio.run_coroutine_threadsafe(open_session(world, SESSION, tenant), running.loop).result(PATIENCE_S)
        yield running


@pytest.fixture(scope="module")
def keys(crowded):
    """The metadata of a client of each tenant."""
    made = {tenant: a_key(crowded.world, tenant=tenant) for tenant in ("greedy", "other")}
    return {tenant: (("authorization", f"Bearer {key.text}"),) for tenant, key in made.items()}


class Watches:
    """`WATCHES` watches on a few connections."""

    def __init__(self, open_watch, targets):
        self._calls = [open_watch(channel) for channel in targets for _ in range(WATCHES // len(targets))]
        self._heads = [asyncio.create_task(call.read()) for call in self._calls]

    async def refusals(self, least):
        """Those that were refused, once there are so many. Whoever is let in is told nothing, or a state."""
        while True:
            ended = [head.exception() for head in self._heads if head.done()]
            refused = [error for error in ended if isinstance(error, grpc.aio.AioRpcError)]
            if len(refused) >= least:
                return refused
            await asyncio.wait([head for head in self._heads if not head.done()], return_when=asyncio.FIRST_COMPLETED)

    def close(self):
        for call in self._calls:
            call.cancel()
        for head in self._heads:
            head.cancel()


@contextlib.asynccontextmanager
async def channels(target, count):
    """Connections of their own."""
    options = [("grpc.use_local_subchannel_pool", 1)]
    opened = [grpc.aio.insecure_channel(target, options) for _ in range(count)]
    yield opened
    await asyncio.gather(*(channel.close() for channel in opened))


def told_when_to_come_back(refusal):
    """The refusal is RESOURCE_EXHAUSTED and carries a retry delay."""
    trailing = dict(refusal.trailing_metadata())
    status = status_pb2.Status.FromString(trailing[errors.STATUS_DETAILS])
    delays = [detail for detail in status.details if detail.Is(error_details_pb2.RetryInfo.DESCRIPTOR)]
    return refusal.code() is grpc.StatusCode.RESOURCE_EXHAUSTED and len(delays) == 1


def gave_way(refusal):
    """A call without a credential that had no message yet while 64 newer ones of its address began."""
    return refusal.code() is grpc.StatusCode.DEADLINE_EXCEEDED


async def serves(crowded, metadata):
    """The other tenant lists and watches, and health is told."""
    async with channels(crowded.grpc, 1) as (channel,):
        health = await health_pb2_grpc.HealthStub(channel).Check(health_pb2.HealthCheckRequest())
        listed = await map_pb2_grpc.MapServiceStub(channel).ListMaps(map_pb2.ListMapsRequest(), metadata=metadata)
        watch = watch_loops(channel, metadata)
        with pytest.raises(asyncio.TimeoutError):
            await asyncio.wait_for(asyncio.shield(watch.read()), 0.3)
        watch.cancel()
        return health.status == 1 and len(listed.maps) == 1


def watch_loops(channel, metadata):
    stub = loop_closure_pb2_grpc.LoopClosureServiceStub(channel)
    request = loop_closure_pb2.WatchLoopClosuresRequest(parent=f"maps/{SESSION.map_id}")
    return stub.WatchLoopClosures(request, metadata=metadata)


def watch_health(channel):
    return health_pb2_grpc.HealthStub(channel).Watch(health_pb2.HealthCheckRequest())


@pytest.mark.parametrize(("who", "let_in"), [("stranger", 8 * CONNECTIONS), ("greedy", 32)])
async def test_whoever_watches_keeps_no_other_tenant_out(crowded, keys, who, let_in):
    """A stranger watches health, a key watches loop closures."""
    opens = watch_health if who == "stranger" else lambda channel: watch_loops(channel, keys[who])
    async with channels(crowded.grpc, CONNECTIONS) as opened:
        with contextlib.closing(Watches(opens, opened)) as watches:
            await watches.refusals(WATCHES - let_in)
            assert await serves(crowded, keys["other"])
            refused = await watches.refusals(WATCHES - let_in)
            assert len(refused) >= WATCHES - let_in
            assert all(gave_way(refusal) or told_when_to_come_back(refusal) for refusal in refused)


async def test_the_places_of_watches_that_ended_are_given_back(crowded, keys):
    async with channels(crowded.grpc, 1) as (channel,), asyncio.timeout(PATIENCE_S):
        with contextlib.closing(Watches(watch_health, [channel])) as watches:
            await watches.refusals(WATCHES - 8)
        while not await lets_in(channel, 8):
            await asyncio.sleep(0.05)


async def lets_in(channel, count):
    """Whether so many watches of health are told a state."""
    calls = [watch_health(channel) for _ in range(count)]
    told = await asyncio.gather(*(call.read() for call in calls), return_exceptions=True)
    for call in calls:
        call.cancel()
    return not any(isinstance(answer, grpc.aio.AioRpcError) for answer in told)


@pytest.mark.parametrize("method", ["/grpc.health.v1.Health/Check", "/revisit.v1.MapService/ListMaps"])
async def test_calls_whose_message_never_comes_keep_nobody_out(crowded, keys, monkeypatch, method):
    monkeypatch.setattr(errors, "PUBLIC_MESSAGE_S", 0.3)
    host, _, port = crowded.grpc.rpartition(":")
    with contextlib.ExitStack() as held:
        for _ in range(3):
            connection = held.enter_context(socket.create_connection((host, int(port))))
            connection.sendall(OPENING + b"".join(call_headers(method, call) for call in range(1, 400, 2)))
        async with asyncio.timeout(PATIENCE_S):
            while not await served_by_now(crowded, keys["other"]):
                await asyncio.sleep(0.05)


async def served_by_now(crowded, metadata):
    """As `serves`; a refusal is no."""
    try:
        return await serves(crowded, metadata)
    except grpc.aio.AioRpcError:
        return False


async def test_authorization_that_is_sent_twice_is_refused_on_both_transports(crowded, keys):
    twice = [*keys["other"], *keys["other"]]
    async with httpx.AsyncClient(base_url=crowded.http, trust_env=False) as http:
        assert (await http.get("/v1/maps", headers=twice)).status_code == 401
        assert (await http.get("/v1/maps", headers=twice[:1])).status_code == 200
    async with channels(crowded.grpc, 1) as (channel,):
        with pytest.raises(grpc.aio.AioRpcError) as refused:
            await map_pb2_grpc.MapServiceStub(channel).ListMaps(map_pb2.ListMapsRequest(), metadata=tuple(twice))
    assert refused.value.code() is grpc.StatusCode.UNAUTHENTICATED


@contextlib.asynccontextmanager
async def small_server(**limits):
    """A server of its own, which lets in few connections; yields its port."""
    server = create_server(memory_world().use_cases, **limits)
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    yield port
    await server.stop(None)


async def raw(port, sent, source="127.0.0.1"):
    """A connection from an address of loopback that has sent something, and been answered if that was a preface."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port, local_addr=(source, 0))
    writer.write(sent)
    await reader.readexactly(1)
    return reader, writer


async def ends(reader):
    """The server has closed the connection."""
    with contextlib.suppress(ConnectionError):
        while await asyncio.wait_for(reader.read(65536), PATIENCE_S):
            pass
    return True


async def list_maps(port):
    async with channels(f"127.0.0.1:{port}", 1) as (channel,):
        await map_pb2_grpc.MapServiceStub(channel).ListMaps(map_pb2.ListMapsRequest(), wait_for_ready=True)


async def test_connections_beyond_those_that_may_be_open_are_closed_at_once_until_one_is_free():
    async with small_server(connections=2) as port:
        held = [await raw(port, OPENING) for _ in range(2)]
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(OPENING)  # a connection that is let in may stay for minutes with it
        assert await ends(reader)
        held[0][1].close()
        await list_maps(port)
        held[1][1].close()


async def test_connections_of_one_address_over_which_nobody_was_admitted_give_way_to_newer_ones(monkeypatch):
    monkeypatch.setattr(open_connections, "POLL_S", 0.01)
    known = open_connections.OpenConnections(UnauthenticatedConnections(2))
    async with small_server(open_connections=known) as port, channels(f"127.0.0.1:{port}", 1) as (channel,):
        stub = map_pb2_grpc.MapServiceStub(channel)
        await stub.ListMaps(map_pb2.ListMapsRequest())
        elsewhere, first, *others = [await raw(port, OPENING, f"127.0.0.{1 + (number == 0)}") for number in range(4)]
        looking = asyncio.create_task(known.watch(port))
        assert await ends(first[0])
        admitted = channel.get_state()
        for reader, _ in (elsewhere, *others):
            with pytest.raises(asyncio.TimeoutError):
                await asyncio.wait_for(ends(reader), 0.1)
        await stub.ListMaps(map_pb2.ListMapsRequest())
        assert (admitted, channel.get_state()) == (grpc.ChannelConnectivity.READY,) * 2
        looking.cancel()
