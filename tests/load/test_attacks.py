"""The attacks from outside in full size, each beside a client of another tenant (P10, P11, P22).

That client posts submaps at a steady rate, alone and then beside the attack, and asks /livez. REVISIT_ATTACK_POSTS is
how often (200). The mechanisms behind are tested in small, without a clock, in tests/contract/api.
"""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest

from revisit import Client, Cloud
from revisit.formats import KITTI, encode_quantised
from tests.support.attackers import ATTACKS, LARGE, attacked, large_cloud
from tests.support.credentials import a_key
from tests.support.figures import publish
from tests.support.load import CALLS, OK, SESSION, Address, quantile, rss_mib
from tests.support.processes import ServiceProcess
from tests.support.service_world import cloud_points, pose, sqlite_world

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

POSTS = int(os.environ.get("REVISIT_ATTACK_POSTS", "200"))
EVERY_S = 0.05
SUBMAPS = 500
GOAL_TIMES, GOAL_MS = 2.0, 50.0
"""Goal for the p99 beside an attack: so many times that of alone, or so much more than it."""

MOST_TIMES, MOST_MS = 10.0, 400.0
"""What is asserted of the median: attackers and service share two cores. Without the bounds it was seconds."""

CEILING_MIB = 512.0
CLOUD = encode_quantised(cloud_points(1, 300))


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    """A service with two tenants; the lists of the greedy one are long, and one of its submaps is large."""
    home = tmp_path_factory.mktemp("home")
    world = sqlite_world(home)
    keys = {tenant: a_key(world, tenant).text for tenant in ("greedy", "modest")}
    world.context.transactions.close()
    running = ServiceProcess(home, workers=0, max_queued_jobs=100_000)
    for key in keys.values():
        with Client(running.url, api_key=key) as client:
            client.create_session(client.create_map("town"), "monday")
            client.post_submap(SESSION, LARGE, Cloud(large_cloud(), KITTI), pose(), 1)
    call = CALLS["rest"](running, CLOUD, keys["greedy"])
    with ThreadPoolExecutor(4) as pool:
        assert set(pool.map(call, (f"s{number}" for number in range(SUBMAPS)))) == {OK}
    yield running, keys
    running.close()


def posts(running, transport: str, key: str, name: str) -> dict[str, list[float]]:
    """How long posts and questions for health took, milliseconds, and what the posts were told."""
    call, took_ms, livez_ms, told = CALLS[transport](running, CLOUD, key), [], [], set()
    with httpx.Client(base_url=running.url, trust_env=False, timeout=60) as http:
        for number in range(POSTS):
            began_s = time.perf_counter()
            told.add(call(f"{name}-{number}"))
            took_ms.append(1e3 * (time.perf_counter() - began_s))
            if number % 10 == 0:
                began_s = time.perf_counter()
                assert http.get("/livez").status_code == 200
                livez_ms.append(1e3 * (time.perf_counter() - began_s))
            time.sleep(EVERY_S)
    assert told == {OK}, told
    return {"posts": took_ms, "livez": livez_ms}


@pytest.mark.parametrize("name", ATTACKS)
def test_another_tenant_is_served_beside_the_attack(service, name):
    running, keys = service
    promise, transport, _ = ATTACKS[name]
    word = name.replace(" ", "-")
    alone = posts(running, transport, keys["modest"], f"{word}-alone")["posts"]
    with attacked(name, Address(running.url, running.grpc_target), keys["greedy"]) as told:
        times = posts(running, transport, keys["modest"], f"{word}-beside")
    beside, memory_mib = times["posts"], round(rss_mib(running.pid))
    alone_ms, beside_ms = ([quantile(share, took) for share in (0.5, 0.99)] for took in (alone, beside))
    met = beside_ms[1] <= max(GOAL_TIMES * alone_ms[1], alone_ms[1] + GOAL_MS)
    publish(
        "attack", promise=promise, attack=name, transport=transport, alone_p50_p99_ms=alone_ms, goal_met=met,
        beside_p50_p99_ms=beside_ms, livez_most_ms=round(max(times["livez"]), 1), gateway_mib=memory_mib,
        load=os.getloadavg()[0], came_of_it=told.counts,
    )  # fmt: skip
    assert told.counts, "there was no attack"
    assert beside_ms[0] < max(MOST_MS, MOST_TIMES * alone_ms[0])
    assert memory_mib < CEILING_MIB
