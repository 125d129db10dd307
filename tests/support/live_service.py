"""A running service on free ports: both transports over chosen stores, and a worker with the fake recogniser."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass

import uvicorn

from revisit import Client
from revisit.sdk.retry import RetryPolicy
from revisit.service.capacity.limits import CallLimits
from revisit.service.grpc.server import create_server
from revisit.service.rest.app import create_app
from revisit.service.rest.limits import HttpLimits
from revisit.service.rest.slow_clients import uvicorn_limits
from tests.support.patience import PATIENCE_S
from tests.support.service_world import World, cloud_points, memory_world, pose


class Working(threading.Event):
    """Whether the worker takes jobs. Once it was cleared, none is taken: also not by a claim that had begun."""

    def __init__(self) -> None:
        super().__init__()
        self.claiming = threading.Lock()

    def clear(self) -> None:
        """From now on no job is taken."""
        super().clear()
        with self.claiming:
            pass


@dataclass
class LiveService:
    """Where it listens, and the world behind it; `working` lets the worker take jobs."""

    http: str
    grpc: str
    world: World
    working: Working
    loop: asyncio.AbstractEventLoop

    def stored(self) -> tuple[int, ...]:
        """How many maps, sessions, scans, submaps and jobs are stored: what a refused request may not change."""
        tables = ("maps", "sessions", "scans", "submaps", "jobs")

        def count(uow):
            return tuple(getattr(uow, table).count("default") for table in tables)

        return self.world.context.transactions.read(count).result()


@contextlib.contextmanager
def live_service(world: World | None = None, limits: CallLimits | None = None, **policy) -> Iterator[LiveService]:
    """Run until the block ends, over `world` where one is given; `limits` are those of both transports."""
    world = world or memory_world(**policy)
    started: list[LiveService] = []
    ready, stop = threading.Event(), threading.Event()
    thread = threading.Thread(target=lambda: asyncio.run(_serve(world, limits, started, ready, stop)), daemon=True)
    thread.start()
    assert ready.wait(PATIENCE_S), "the service did not start"
    worker = threading.Thread(target=_work, args=(started[0], stop), daemon=True)
    worker.start()
    try:
        yield started[0]
    finally:
        stop.set()
        thread.join(PATIENCE_S)
        worker.join(PATIENCE_S)


def connected(
    service: LiveService, transport: str, retry: RetryPolicy = RetryPolicy(attempts=1, base_s=0.01)
) -> Client:
    """A client over `rest` or `grpc`; without retries, the first answer is what a test sees."""
    return Client(service.http, retry=retry) if transport == "rest" else Client.grpc(service.grpc, retry=retry)


async def _serve(
    world: World,
    limits: CallLimits | None,
    started: list[LiveService],
    ready: threading.Event,
    stop: threading.Event,
) -> None:
    rpc = create_server(world.use_cases, call_limits=limits or CallLimits())
    grpc_port = rpc.add_insecure_port("127.0.0.1:0")
    await rpc.start()
    world.use_cases.system.reached_at(f":{grpc_port}")
    listener = socket.create_server(("127.0.0.1", 0))
    # asyncio, unlike the gateway's uvloop, leaves Nagle's algorithm on: 40 ms for each answer.
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    config = uvicorn.Config(
        create_app(world.use_cases, HttpLimits() if limits is None else HttpLimits(calls=limits)),
        log_config=None,
        **uvicorn_limits(),
    )
    http = uvicorn.Server(config)
    http.capture_signals = contextlib.nullcontext
    serving = asyncio.create_task(http.serve(sockets=[listener]))
    while not http.started:
        await asyncio.sleep(0.01)
    address = f"http://127.0.0.1:{listener.getsockname()[1]}"
    loop = asyncio.get_running_loop()
    started.append(LiveService(address, f"127.0.0.1:{grpc_port}", world, Working(), loop))
    started[0].working.set()
    ready.set()
    while not stop.is_set():
        await asyncio.sleep(0.05)
    http.should_exit = True
    await asyncio.gather(serving, rpc.stop(grace=0.2))


def _work(service: LiveService, stop: threading.Event) -> None:
    recognition = service.world.worker()
    while not stop.is_set():
        with service.working.claiming:
            lease = service.world.claim() if service.working.is_set() else None
        if lease is None:
            time.sleep(0.01)
        else:
            recognition.run(lease)


def published_drives(client):
    """The file of a map of two drives through the same three places."""
    town = client.create_map("town", leave_distance_m=0)
    for name in ("monday", "tuesday"):
        session = client.create_session(town, name)
        for place in range(1, 4):
            client.wait(client.post_submap(session, f"s{place}", cloud_points(place), pose(5.0 * place), place))
    client.wait(client.optimise_map(town.name))
    return client.get_map_file(client.wait(client.publish_map(town.name)).result["map_file"])
