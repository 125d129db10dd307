"""What `test_overload.py` and `test_fairness.py` measure over REST, of a server that only writes and syncs posts.

As far as accepted posts wait longer there too, beside others that are refused, it is the machine. REVISIT_LOAD_S
seconds for each phase (20). Nothing but that it works is asserted: the figures stand beside those of the service.
"""

from __future__ import annotations

import threading

import pytest

from tests.load import test_fairness as fairness
from tests.load import test_overload as overload
from tests.support.bare_server import bare_server
from tests.support.figures import publish
from tests.support.load import OK, Address, Sender, Tally, rest_call, run_for

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]


def answers(url: str, name: str, seconds: float, clients: int, per_s: float) -> Tally:
    """What clients see that send the cloud of the overload, so many a second together."""
    tally, stop = Tally(), threading.Event()
    calls = [rest_call(Address(url, ""), overload.CLOUD) for _ in range(clients)]
    senders = (Sender(f"{name}{number}", call, tally, clients / per_s, stop) for number, call in enumerate(calls))
    run_for(seconds, stop, *senders)
    return tally


def test_ten_times_what_a_bare_server_takes(tmp_path):
    taken_per_s = overload.TAKEN_PER_S
    with bare_server(tmp_path / "posts", taken_per_s) as url:
        calm = answers(url, "calm", overload.CALM_S, clients=2, per_s=taken_per_s / 2)
        flood = answers(url, "flood", overload.LOAD_S, overload.CLIENTS, per_s=overload.TIMES * taken_per_s)
    times = {
        f"{name}_accepted_p50_p99_ms": [tally.quantile_ms(share, OK) for share in (0.5, 0.99)]
        for name, tally in (("calm", calm), ("flood", flood))
    }
    counts = {"calm": calm.counts(), "flood": flood.counts()}
    publish("bare_overload", promise="P10", seconds=overload.LOAD_S, **counts, **times)
    assert calm.others(OK) == flood.others(OK, "RATE") == {}
    assert flood.counts()["RATE"] > flood.counts()[OK] > 0


def test_a_greedy_caller_of_a_bare_server(tmp_path):
    with bare_server(tmp_path / "posts", fairness.QUOTA_PER_S) as url:
        server = Address(url, ""), {"greedy": "greedy", "modest": "modest"}
        alone = fairness.phase(server, "rest", "alone")
        beside, greedy = fairness.phase_beside_the_greedy(server, "rest")
    times = {
        f"{name}_p50_p99_ms": [tally.quantile_ms(share, OK) for share in (0.5, 0.99)]
        for name, tally in (("alone", alone), ("beside", beside))
    }
    publish("bare_fairness", promise="P11", seconds=fairness.LOAD_S, greedy=greedy, modest=beside.counts(), **times)
    assert alone.others(OK) == beside.others(OK) == {}
    assert greedy["RATE"] > greedy[OK] > 0
