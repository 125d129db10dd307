"""One tenant at 50 times its quota, another below its own (P11), over both transports.

REVISIT_LOAD_S is the length of each phase in seconds (20). The clients of the greedy tenant are a process of their own,
for threads of one process would wait for each other before they wait for the service.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import threading

import pytest

from revisit.formats import encode_quantised
from revisit.service.capacity.limits import CALL_POINTS
from tests.support.credentials import a_key
from tests.support.figures import publish
from tests.support.load import CALLS, OK, Address, Sender, Tally, run_for
from tests.support.processes import ServiceProcess
from tests.support.service_world import cloud_points, open_session, sqlite_world

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
    for tenant in keys:  # here, for a call that creates would use a small quota up for half a minute
        asyncio.run(open_session(world, tenant=tenant))
    world.context.transactions.close()
    points_per_s = QUOTA_PER_S * (POINTS + CALL_POINTS)
    running = ServiceProcess(tmp_path / "home", workers=1, client_points_per_s=points_per_s)
    yield running, keys
    running.close()


def be_greedy(address, transport, key, ready, told):
    """A process: keeps the rate up for LOAD_S from when it is `ready`; tells how many answers there were by outcome."""
    tally, stop, every_s = Tally(), threading.Event(), GREEDY_CLIENTS / (TIMES * QUOTA_PER_S)
    calls = [CALLS[transport](address, CLOUD, key) for _ in range(GREEDY_CLIENTS)]
    senders = (Sender(f"greedy{number}", call, tally, every_s, stop) for number, call in enumerate(calls))
    ready.set()
    run_for(LOAD_S, stop, *senders)
    told.put(tally.counts())


def phase(service, transport, name):
    """What the modest tenant sees in LOAD_S."""
    running, keys = service
    modest, stop, call = Tally(), threading.Event(), CALLS[transport](running, CLOUD, keys["modest"])
    run_for(LOAD_S, stop, Sender(name, call, modest, MODEST_EVERY_S, stop))
    return modest


def phase_beside_the_greedy(service, transport):
    """As `phase`, and the answers that the greedy tenant gets meanwhile."""
    running, keys = service
    processes = multiprocessing.get_context("spawn")
    ready, told = processes.Event(), processes.Queue()
    address = Address(running.url, running.grpc_target)
    greedy = processes.Process(target=be_greedy, args=(address, transport, keys["greedy"], ready, told))
    greedy.start()
    assert ready.wait(60)
    modest = phase(service, transport, "beside")
    answers = told.get(timeout=60)
    greedy.join(60)
    return modest, answers


@pytest.mark.parametrize("transport", ["rest", "grpc"])
def test_a_greedy_tenant_slows_no_other_down(service, transport):
    alone = phase(service, transport, "alone")
    beside, greedy = phase_beside_the_greedy(service, transport)
    times = {name: [tally.quantile_ms(share, OK) for share in (0.5, 0.99)] for name, tally in
             (("alone_p50_p99_ms", alone), ("beside_p50_p99_ms", beside))}  # fmt: skip
    answers = {"greedy": greedy, "modest": beside.counts()}
    publish("fairness", promise="P11", transport=transport, seconds=LOAD_S, **answers, **times)
    assert alone.others(OK) == beside.others(OK) == {}
    assert set(greedy) <= {OK, "RATE", "WORKERS_BUSY"}
    assert greedy["RATE"] > greedy[OK]
    for alone_ms, beside_ms in zip(*times.values(), strict=True):
        assert beside_ms <= max(MOST_TIMES_SLOWER * alone_ms, alone_ms + NOISE_MS)
