"""One tenant at 50 times its quota, another below its own (P11), over both transports.

REVISIT_LOAD_S is the length of each phase in seconds (20).
"""

from __future__ import annotations

import os
import threading

import pytest

from core.formats import encode_quantised
from revisit import Client
from service.application.intake import CALL_POINTS
from tests.support.credentials import a_key
from tests.support.figures import publish
from tests.support.load import CALLS, OK, Sender, Tally, run_for
from tests.support.processes import ServiceProcess
from tests.support.service_world import cloud_points, sqlite_world

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]

LOAD_S = float(os.environ.get("REVISIT_LOAD_S", "20"))
POINTS = 300
QUOTA_PER_S = 4.0
TIMES = 50
GREEDY_CLIENTS = 8
MODEST_EVERY_S = 1.5 / QUOTA_PER_S
MOST_TIMES_SLOWER = 1.5
NOISE_MS = 50.0
"""What quantiles may differ by in any case: the clients of the greedy tenant work on the same machine."""
CLOUD = encode_quantised(cloud_points(1, POINTS))


@pytest.fixture
def service(tmp_path):
    world = sqlite_world(tmp_path / "home")
    keys = {tenant: a_key(world, tenant).text for tenant in ("greedy", "modest")}
    world.context.transactions.close()
    points_per_s = QUOTA_PER_S * (POINTS + CALL_POINTS)
    running = ServiceProcess(tmp_path / "home", workers=1, tenant_points_per_s=points_per_s)
    for key in keys.values():
        with Client(running.url, api_key=key) as client:
            client.create_session(client.create_map("town"), "monday")
    yield running, keys
    running.close()


def phase(service, transport, name, greedy_clients):
    """What the modest tenant saw beside so many clients of the greedy one, and what these saw."""
    running, keys = service
    modest, greedy, stop = Tally(), Tally(), threading.Event()
    every_s = GREEDY_CLIENTS / (TIMES * QUOTA_PER_S)
    senders = [Sender(f"{name}-modest", CALLS[transport](running, CLOUD, keys["modest"]), modest, MODEST_EVERY_S, stop)]
    for number in range(greedy_clients):
        call = CALLS[transport](running, CLOUD, keys["greedy"])
        senders.append(Sender(f"{name}-greedy{number}", call, greedy, every_s, stop))
    run_for(LOAD_S, stop, *senders)
    return modest, greedy


@pytest.mark.parametrize("transport", ["rest", "grpc"])
def test_a_greedy_tenant_slows_no_other_down(service, transport):
    alone, _ = phase(service, transport, "alone", 0)
    beside, greedy = phase(service, transport, "beside", GREEDY_CLIENTS)
    times = {name: [tally.quantile_ms(share, OK) for share in (0.5, 0.99)] for name, tally in
             (("alone_p50_p99_ms", alone), ("beside_p50_p99_ms", beside))}  # fmt: skip
    answers = {"greedy": greedy.counts(), "modest": beside.counts()}
    publish("fairness", promise="P11", transport=transport, seconds=LOAD_S, **answers, **times)
    assert beside.others(OK) == {}
    assert greedy.others(OK, "RATE", "WORKERS_BUSY") == {}
    assert greedy.counts()["RATE"] > greedy.counts()[OK]
    for alone_ms, beside_ms in zip(*times.values(), strict=True):
        assert beside_ms <= max(MOST_TIMES_SLOWER * alone_ms, alone_ms + NOISE_MS)
