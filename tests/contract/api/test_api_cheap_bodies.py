"""What costs its sender next to nothing keeps no other tenant waiting (P11, P12): bodies that are refused, long lists.

A client of one tenant posts submaps while clients of another, in a process of their own, do nothing but attack.
"""

from __future__ import annotations

import gzip
import http.client
import json
import multiprocessing
import statistics
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from urllib.parse import urlsplit

import httpx
import pytest

from revisit.formats import PLY, QUANTISED, encode_quantised
from tests.support.credentials import a_key, bearer
from tests.support.figures import publish
from tests.support.patience import PATIENCE_S, in_time
from tests.support.processes import ServiceProcess
from tests.support.service_world import cloud_points, sqlite_world

TENANTS = ("greedy", "modest")
SUBMAPS = 500
POSTS, FEW_POSTS = 30, 8
EVERY_S = 0.05
MOST_MS, MOST_TIMES = 400.0, 10.0
"""What the median of the posts may be, or how many times that without attackers, who work on the same two cores.

Before there were bounds it was seconds, and a hundred times.
"""
PLACE = "T_odom_submap=0,0,0,0,0,0,1&stamp_ns=1"
SUBMAPS_OF_MONDAY = "/v1/maps/town/sessions/monday/submaps"


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


def attacks() -> dict[str, tuple[int, str, str, bytes, dict[str, str]]]:
    """By name: how many clients send what."""
    as_json = {"content-type": "application/json"}
    as_ply = {"content-type": PLY, "content-encoding": "gzip"}
    search, post = "/v1/maps/town/submaps:search", f"{SUBMAPS_OF_MONDAY}?submap_id=bad&{PLACE}"
    return {
        "long JSON": (8, "POST", search, long_json(), as_json),
        "refused descriptors": (8, "POST", search, descriptor_json(), as_json),
        "ASCII clouds": (6, "POST", post, bad_in_the_last_token(7.5), as_ply),
        "long lists": (8, "GET", f"{SUBMAPS_OF_MONDAY}?page_size=500", b"", {}),
    }


def be_greedy(address: str, key: dict[str, str], name: str, ready, stop, told) -> None:
    """A process: its clients send one request after the other until told to stop."""
    clients, method, path, body, headers = attacks()[name]
    counts: list[str] = []

    def send() -> None:
        connection = http.client.HTTPConnection(address, timeout=PATIENCE_S)
        while not stop.is_set():
            try:
                connection.request(method, path, body or None, {**headers, **key})
                answer = connection.getresponse()
                answer.read()
                counts.append(str(answer.status))
            except (OSError, http.client.HTTPException):
                connection.close()
                counts.append("cut")

    threads = [threading.Thread(target=send) for _ in range(clients)]
    for thread in threads:
        thread.start()
    ready.set()
    for thread in threads:
        thread.join()
    told.put({status: counts.count(status) for status in sorted(set(counts))})


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    """A service with both tenants."""
    home = tmp_path_factory.mktemp("home")
    world = sqlite_world(home)
    keys = {tenant: bearer(a_key(world, tenant)) for tenant in TENANTS}
    world.context.transactions.close()
    running = ServiceProcess(home, workers=0, max_queued_jobs=100_000)
    for key in keys.values():
        with httpx.Client(base_url=running.url, trust_env=False, headers=key, timeout=PATIENCE_S) as client:
            client.post("/v1/maps", json={"map_id": "town"}).raise_for_status()
            client.post("/v1/maps/town/sessions", json={"session_id": "monday"}).raise_for_status()
    yield running, keys
    running.close()


CLOUD = encode_quantised(cloud_points(1, 300))


def post(client: httpx.Client, submap_id: str) -> float:
    """Post a submap; how long it took, milliseconds."""
    began_s = time.perf_counter()
    headers = {"content-type": QUANTISED}
    answer = client.post(f"{SUBMAPS_OF_MONDAY}?submap_id={submap_id}&{PLACE}", content=CLOUD, headers=headers)
    assert answer.status_code == 202, answer.text
    return 1e3 * (time.perf_counter() - began_s)


def lengthen_lists(running, key: dict[str, str]) -> None:
    """Store as many submaps as a page may have."""
    with httpx.Client(base_url=running.url, trust_env=False, headers=key) as client, ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda number: post(client, f"s{number}"), range(SUBMAPS)))


def posts(running, key: dict[str, str], name: str, count: int) -> list[float]:
    """The times of so many posts, milliseconds, in order of size."""
    times = []
    with httpx.Client(base_url=running.url, trust_env=False, headers=key) as client:
        for number in range(count):
            times.append(post(client, f"{name}-{number}"))
            time.sleep(EVERY_S)
    return sorted(times)


@pytest.mark.parametrize(
    ("name", "count"),
    [("long JSON", FEW_POSTS), *(pytest.param(name, POSTS, marks=pytest.mark.slow) for name in attacks())],
)
def test_what_is_cheap_to_send_delays_no_other_tenant(service, name, count):
    running, keys = service
    word = name.replace(" ", "-")
    if name == "long lists":
        lengthen_lists(running, keys["greedy"])
    alone = posts(running, keys["modest"], f"{word}-{count}-alone", count)
    processes = multiprocessing.get_context("spawn")
    ready, stop, told = processes.Event(), processes.Event(), processes.Queue()
    address = urlsplit(running.url).netloc
    attacker = processes.Process(target=be_greedy, args=(address, keys["greedy"], name, ready, stop, told))
    attacker.start()
    assert ready.wait(PATIENCE_S)
    beside = posts(running, keys["modest"], f"{word}-{count}-beside", count)
    stop.set()
    answered = told.get(timeout=PATIENCE_S)
    attacker.join(PATIENCE_S)
    middle = [round(statistics.median(times), 1) for times in (alone, beside)]
    publish("cheap bodies", attack=name, alone_ms=middle[0], beside_ms=middle[1], p99_ms=beside[-1], answers=answered)
    assert answered, "nothing was attacked"
    assert in_time(middle[1], max(MOST_MS, MOST_TIMES * middle[0])), (alone, beside, answered)
