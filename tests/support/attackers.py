"""Attackers for the full-size attacks: processes of their own, less urgent than the service."""

from __future__ import annotations

import asyncio
import gzip
import http.client
import json
import math
import multiprocessing
import os
import resource
import selectors
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import grpc
import numpy as np
from grpc_health.v1 import health_pb2, health_pb2_grpc

from revisit.formats import KITTI, PLY
from revisit.v1 import cloud_pb2, loop_closure_pb2, loop_closure_pb2_grpc
from tests.support.http2 import PREFACE
from tests.support.load import SESSION, Address

TOWN = SESSION.partition("/sessions/")[0]
PLACE = "T_odom_submap=0,0,0,0,0,0,1&stamp_ns=1"
SEARCH, SUBMAPS = f"/v1/{TOWN}/submaps:search", f"/v1/{SESSION}/submaps"
LARGE, POINTS = "large", 1_900_000

LESS_URGENT = 5
"""So much nicer than the service are the attackers, whose work others' machines would do."""

Attack = Callable[[Address, str, Any, Counter[str]], None]
"""Attacks an address with a key until an event is set; counts what comes of it."""


def long_json() -> bytes:
    """A search of 650 kB that fits no schema."""
    return json.dumps({"descriptor": [0.123456789] * 50_000, "wrong": 1}).encode()


def descriptor_json() -> bytes:
    """A search by the longest descriptor, refused at its last field."""
    return json.dumps({"descriptor": [0.12345678901234567] * 4096, "wrong": 1}).encode()


def bad_in_the_last_token(mebibytes: float) -> bytes:
    """An ASCII cloud whose last number is none, compressed."""
    table = [
        b"%.3f %.3f %.3f\n" % (10 + number * 7 % 80, 20 + number * 11 % 70, 30 + number % 61) for number in range(9973)
    ]
    rows = int(mebibytes * 2**20) // len(table[0])
    rows -= rows % len(table)
    head = f"ply\nformat ascii 1.0\nelement vertex {rows + 1}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    return gzip.compress(head.encode() + b"".join(table) * (rows // len(table)) + b"1.25 2.5 wrong\n", 6)


def large_cloud(points: int = POINTS) -> bytes:
    """A cloud of the format KITTI in which little changes, so that it compresses well."""
    table = np.zeros((points, 4), np.float32)
    table[:, 0] = np.arange(points) % 50
    table[:, 1] = np.arange(points) % 7
    table[:, 2] = np.arange(points) % 3
    return table.tobytes()


def repeat(
    clients: int,
    method: str,
    path: str,
    body: Callable[[], bytes],
    headers: dict[str, str],
    address: Address,
    key: str,
    stop: Any,
    counts: Counter[str],
) -> None:
    """Clients that send one request after the other."""
    data = body()

    def send() -> None:
        connection = http.client.HTTPConnection(address.url.removeprefix("http://"), timeout=90)
        while not stop.is_set():
            counts["sent"] += 1
            try:
                connection.request(method, path, data or None, {**headers, "authorization": f"Bearer {key}"})
                answer = connection.getresponse()
                answer.read()
                counts[str(answer.status)] += 1
            except (OSError, http.client.HTTPException):
                connection.close()
                counts["cut"] += 1

    threads = [threading.Thread(target=send) for _ in range(clients)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def hold(port: str, count: int, sent: bytes, address: Address, key: str, stop: Any, counts: Counter[str]) -> None:
    """So many sockets that have sent something and read nothing; those that are closed are opened again."""
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(4096, 2 * count), resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
    target = address.url.removeprefix("http://") if port == "http" else address.grpc_target
    host, _, number = target.rpartition(":")
    data = sent.replace(b"KEY", key.encode())
    held = selectors.DefaultSelector()
    while not stop.is_set():
        while len(held.get_map()) < count and not stop.is_set():
            with suppress(OSError):
                connection = socket.socket()
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                connection.settimeout(5.0)
                connection.connect((host, int(number)))
                connection.setblocking(False)
                held.register(connection, selectors.EVENT_READ)
                counts["opened"] += 1
                connection.send(data)
        stop.wait(0.2)
        for known in list(held.get_map().values()):
            if _gone(known.fileobj, data):
                held.unregister(known.fileobj)
                known.fileobj.close()


def _gone(connection: Any, data: bytes) -> bool:
    """Whether the other side has closed a connection of which nothing is read; sends some more where it can."""
    try:
        if len(data) > 2000:
            connection.send(data)
        elif not connection.recv(1, socket.MSG_PEEK):
            return True
    except BlockingIOError:
        return False
    except OSError:
        return True
    return False


def reopen(
    path: str, every: int, address: Address, key: str, stop: Any, counts: Counter[str], *, a_second: float = math.inf
) -> None:
    """Connections of one request each, as fast as they go or so many a second; none is read, and `every` of them are
    closed together.
    """
    host, _, number = address.url.removeprefix("http://").rpartition(":")
    head = f"GET {path} HTTP/1.1\r\nHost: localhost\r\n"
    request = (head + (f"Authorization: Bearer {key}\r\n\r\n" if every == 1 else "\r\n")).encode()
    held: list[socket.socket] = []
    began_s = time.monotonic()
    while not stop.is_set():
        if counts["opened"] > a_second * (time.monotonic() - began_s):
            time.sleep(0.001)
            continue
        with suppress(OSError):
            connection = socket.create_connection((host, int(number)), timeout=2.0)
            held.append(connection)
            connection.sendall(request)
            counts["opened"] += 1
        if len(held) >= every:
            for connection in held:
                connection.close()
            held.clear()


def cancel(kind: str, address: Address, key: str, stop: Any, counts: Counter[str]) -> None:
    """Calls that are cancelled after a millisecond."""
    metadata = (("authorization", f"Bearer {key}"),)
    with grpc.insecure_channel(address.grpc_target) as channel:
        while not stop.is_set():
            if kind == "health":
                call = health_pb2_grpc.HealthStub(channel).Check.future(health_pb2.HealthCheckRequest())
            else:
                stub = loop_closure_pb2_grpc.LoopClosureServiceStub(channel)
                call = stub.WatchLoopClosures(loop_closure_pb2.WatchLoopClosuresRequest(parent=TOWN), metadata=metadata)
            time.sleep(0.001)
            call.cancel()
            counts["cancelled"] += 1


def watch(kind: str, count: int, address: Address, key: str, stop: Any, counts: Counter[str]) -> None:
    """So many watches on three connections; those that are refused are tried again a second later."""
    asyncio.run(_watch(kind, count, address, key, stop, counts))


async def _watch(kind: str, count: int, address: Address, key: str, stop: Any, counts: Counter[str]) -> None:
    options, metadata = [("grpc.use_local_subchannel_pool", 1)], (("authorization", f"Bearer {key}"),)

    async def one(channel: grpc.aio.Channel) -> None:
        while not stop.is_set():
            if kind == "health":
                call = health_pb2_grpc.HealthStub(channel).Watch(health_pb2.HealthCheckRequest())
            else:
                stub = loop_closure_pb2_grpc.LoopClosureServiceStub(channel)
                request = loop_closure_pb2.WatchLoopClosuresRequest(parent=TOWN)
                call = stub.WatchLoopClosures(request, metadata=metadata)
            counts["opened"] += 1
            try:
                async for _ in call:
                    pass
            except grpc.aio.AioRpcError as error:
                counts[error.code().name] += 1
            await asyncio.sleep(1.0)

    channels = [grpc.aio.insecure_channel(address.grpc_target, options) for _ in range(3)]
    tasks = [asyncio.create_task(one(channels[number % 3])) for number in range(count)]
    while not stop.is_set():
        await asyncio.sleep(0.2)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


def localize(count: int, address: Address, key: str, stop: Any, counts: Counter[str]) -> None:
    """So many calls of 15 MiB at a time that wait for a submap which nobody describes."""
    asyncio.run(_localize(count, address, key, stop, counts))


async def _localize(count: int, address: Address, key: str, stop: Any, counts: Counter[str]) -> None:
    cloud = cloud_pb2.EncodedCloud(content_type=KITTI, data=large_cloud(15 * 2**20 // 16))
    request = loop_closure_pb2.LocalizeRequest(
        parent=TOWN, cloud=cloud_pb2.Cloud(encoded=cloud), min_seq=1, min_seq_timeout_s=3
    )
    async with grpc.aio.insecure_channel(address.grpc_target) as channel:
        stub = loop_closure_pb2_grpc.LoopClosureServiceStub(channel)

        async def one() -> None:
            while not stop.is_set():
                counts["sent"] += 1
                try:
                    await stub.Localize(request, timeout=60, metadata=(("authorization", f"Bearer {key}"),))
                except grpc.aio.AioRpcError as error:
                    counts[error.code().name] += 1
                await asyncio.sleep(0.5)

        await asyncio.gather(*(one() for _ in range(count)))


def pipeline(path: str) -> bytes:
    """A hundred requests in a row."""
    return f"GET {path} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer KEY\r\n\r\n".encode() * 100


_JSON = {"content-type": "application/json"}
_PLY = {"content-type": PLY, "content-encoding": "gzip"}
_KITTI = {"content-type": KITTI, "content-encoding": "gzip"}

ATTACKS: dict[str, tuple[str, str, Attack]] = {
    "long JSON": ("P11", "rest", partial(repeat, 8, "POST", SEARCH, long_json, _JSON)),
    "refused descriptors": ("P11", "rest", partial(repeat, 8, "POST", SEARCH, descriptor_json, _JSON)),
    "ASCII clouds": (
        "P11",
        "rest",
        partial(repeat, 6, "POST", f"{SUBMAPS}?submap_id=bad&{PLACE}", partial(bad_in_the_last_token, 7.5), _PLY),
    ),
    "long lists": ("P11", "rest", partial(repeat, 8, "GET", f"{SUBMAPS}?page_size=500", bytes, {})),
    "health watches": ("P22", "grpc", partial(watch, "health", 600)),
    "loop watches": ("P11", "grpc", partial(watch, "loops", 600)),
    "unread pipelines": ("P22", "rest", partial(hold, "http", 1023, pipeline("/page.js"))),
    "half heads": ("P22", "rest", partial(hold, "http", 1100, b"GET /livez HTTP/1.1\r\nHost: localhost\r\nX-Slow: ")),
    "half prefaces": ("P22", "grpc", partial(hold, "grpc", 1100, PREFACE[:10])),
    "compressed searches": (
        "P10",
        "rest",
        partial(
            repeat,
            60,
            "POST",
            f"{SEARCH}?min_seq=1&min_seq_timeout_s=3",
            lambda: gzip.compress(large_cloud(), 9),
            _KITTI,
        ),
    ),
    "large localizes": ("P10", "grpc", partial(localize, 150)),
    "repeated creates": ("P11", "rest", partial(repeat, 8, "POST", "/v1/maps", lambda: b'{"map_id": "again"}', _JSON)),
    "gzip bombs": (
        "P11",
        "rest",
        partial(repeat, 6, "POST", f"{SUBMAPS}?submap_id=bomb&{PLACE}", lambda: gzip.compress(bytes(2**26), 9), _KITTI),
    ),
    "abandoned waits": ("P11", "rest", partial(reopen, f"/v1/{TOWN}/loopClosures?min_seq=1&min_seq_timeout_s=60", 1)),
    "reopened connections": ("P12", "rest", partial(reopen, "/v1/maps", 300)),
    "connections at 5000 a second": ("P12", "rest", partial(reopen, "/v1/maps", 300, a_second=5000)),
    "cancelled watches": ("P11", "grpc", partial(cancel, "loops")),
    "cancelled health": ("P12", "grpc", partial(cancel, "health")),
    "endless heads": ("P22", "rest", partial(hold, "http", 200, b"GET /livez HTTP/1.1\r\n" + b"X-A: b\r\n" * 1000)),
    "unread events": (
        "P22",
        "rest",
        partial(
            hold,
            "http",
            600,
            f"GET /v1/{TOWN}/events?after=0 HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer KEY\r\n\r\n".encode(),
        ),
    ),
    "unread downloads": (
        "P10",
        "rest",
        partial(
            hold,
            "http",
            100,
            f"GET {SUBMAPS}/{LARGE}:download?format=ply HTTP/1.1\r\nHost: localhost\r\n"
            "Authorization: Bearer KEY\r\n\r\n".encode(),
        ),
    ),
}
"""By name: the promise that is attacked, the transport that it is attacked over, and the attack."""


@dataclass
class Told:
    """What an attack says when it has ended."""

    counts: dict[str, int]


def _tell_once_begun(counts: Counter[str], ready: Any) -> None:
    while not counts:
        time.sleep(0.05)
    ready.set()


def _be_greedy(name: str, address: Address, key: str, ready: Any, stop: Any, told: Any) -> None:
    os.nice(LESS_URGENT)
    counts: Counter[str] = Counter()
    threading.Thread(target=_tell_once_begun, args=(counts, ready), daemon=True).start()
    ATTACKS[name][2](address, key, stop, counts)
    told.put(dict(counts))


@contextmanager
def attacked(name: str, address: Address, key: str) -> Iterator[Told]:
    """The attack goes on until the block ends; what came of it is told then."""
    processes = multiprocessing.get_context("spawn")
    ready, stop, told = processes.Event(), processes.Event(), processes.Queue()
    attacker = processes.Process(target=_be_greedy, args=(name, address, key, ready, stop, told))
    attacker.start()
    outcome = Told({})
    try:
        assert ready.wait(120)
        time.sleep(1.0)
        yield outcome
    finally:
        stop.set()
        with suppress(Exception):
            outcome.counts.update(told.get(timeout=120))
        attacker.join(30)
        attacker.kill()
