"""The real service under more load than it can do (P10) and with one greedy tenant (P11's share: one client of many).

Sizes are environment variables: REVISIT_LOAD_S seconds of each phase (20), REVISIT_LOAD_CLIENTS flooding clients (40).
What is measured is printed as one JSON line, for the table in docs/reference/reliability.md.
"""

from __future__ import annotations

import json
import os
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import numpy as np
import pytest

from core.formats import QUANTISED, encode_quantised
from tests.support.processes import ServiceProcess
from tests.support.service_world import cloud_points

pytestmark = pytest.mark.slow

LOAD_S = float(os.environ.get("REVISIT_LOAD_S", "20"))
CLIENTS = int(os.environ.get("REVISIT_LOAD_CLIENTS", "40"))
POINTS = 20_000
RSS_CAP_MIB = 1024
QUEUE_BOUND = 200
CLOUD = encode_quantised(cloud_points(1, POINTS))


@dataclass
class Tally:
    """What one kind of client saw: seconds that answers took, by status."""

    took_s: dict[int, list[float]] = field(default_factory=dict)
    broken: int = 0

    def note(self, status: int, seconds: float) -> None:
        """Count an answer."""
        self.took_s.setdefault(status, []).append(seconds)

    def quantile_ms(self, status: int, share: float) -> float:
        """Of the answers with this status, milliseconds."""
        return round(1000 * float(np.quantile(self.took_s[status], share)), 1)

    def counts(self) -> dict[int, int]:
        """Answers by status."""
        return {status: len(seconds) for status, seconds in sorted(self.took_s.items())}


class Poster(threading.Thread):
    """Posts one submap after another, `every_s` apart, until told to stop; takes no notice of Retry-After."""

    def __init__(self, url: str, name: str, tally: Tally, every_s: float, stop: threading.Event) -> None:
        super().__init__(name=name, daemon=True)
        self._url, self._tally, self._every_s, self._stopped = url, tally, every_s, stop

    def run(self) -> None:
        with httpx.Client(base_url=self._url, timeout=30, trust_env=False) as client:
            number = 0
            while not self._stopped.wait(self._every_s):
                number += 1
                params = {"submap_id": f"{self.name}-{number}", "stamp_ns": number, "T_odom_submap": "0,0,0,0,0,0,1"}
                began_s = time.perf_counter()
                try:
                    answer = client.post(
                        "/v1/maps/town/sessions/monday/submaps",
                        params=params,
                        content=CLOUD,
                        headers={"content-type": QUANTISED},
                    )
                    self._tally.note(answer.status_code, time.perf_counter() - began_s)
                except httpx.HTTPError:
                    self._tally.broken += 1


class Watch(threading.Thread):
    """Looks at the service meanwhile: memory of the gateway, the queue, and how long /livez takes."""

    def __init__(self, service: ServiceProcess, stop: threading.Event) -> None:
        super().__init__(daemon=True)
        self._service, self._stopped = service, stop
        self.rss_mib, self.queued, self.livez = 0.0, 0, Tally()

    def run(self) -> None:
        status = Path(f"/proc/{self._service._process.pid}/status")
        with httpx.Client(base_url=self._service.url, timeout=30, trust_env=False) as client:
            while not self._stopped.wait(0.2):
                line = next(line for line in status.read_text().splitlines() if line.startswith("VmRSS"))
                self.rss_mib = max(self.rss_mib, int(line.split()[1]) / 1024)
                began_s = time.perf_counter()
                answer = client.get("/livez")
                self.livez.note(answer.status_code, time.perf_counter() - began_s)
                self.queued = max(self.queued, client.get("/v1/status").json()["queued_jobs"])


@pytest.fixture
def service(tmp_path):
    running = ServiceProcess(
        tmp_path / "home", workers=1, fake_delay_s="0.01", max_queued_jobs=QUEUE_BOUND, tenant_points_per_s=2e6
    )
    with httpx.Client(base_url=running.url, trust_env=False) as client:
        client.post("/v1/maps", json={"map_id": "town"})
        client.post("/v1/maps/town/sessions", json={"session_id": "monday"})
    yield running
    running.close()


def phase(service, name, clients, every_s):
    """One load for LOAD_S; what its clients and the watch saw."""
    tally, stop = Tally(), threading.Event()
    watch = Watch(service, stop)
    threads = [watch, *(Poster(service.url, f"{name}{number}", tally, every_s, stop) for number in range(clients))]
    for thread in threads:
        thread.start()
    time.sleep(LOAD_S)
    stop.set()
    for thread in threads:
        thread.join(60)
    return tally, watch


def test_ten_times_the_load_is_refused_not_absorbed(service):
    calm, _ = phase(service, "calm", clients=2, every_s=0.1)
    flood, watch = phase(service, "flood", clients=CLIENTS, every_s=0.0)
    refused = [status for status in flood.took_s if status in (429, 503)]
    figures = {
        "seconds": LOAD_S,
        "calm": calm.counts(),
        "calm_p99_ms": calm.quantile_ms(202, 0.99),
        "flood": flood.counts(),
        "broken": flood.broken,
        "accepted_p99_ms": flood.quantile_ms(202, 0.99),
        "refused_p50_ms": {status: flood.quantile_ms(status, 0.5) for status in refused},
        "refused_p99_ms": {status: flood.quantile_ms(status, 0.99) for status in refused},
        "livez_p99_ms": watch.livez.quantile_ms(200, 0.99),
        "gateway_rss_mib": round(watch.rss_mib),
        "queued": watch.queued,
    }
    print(json.dumps(figures))
    assert set(flood.took_s) <= {202, 429, 503}
    assert refused and len(flood.took_s[202]) > 0
    assert flood.broken == 0
    assert watch.queued <= QUEUE_BOUND
    assert watch.rss_mib < RSS_CAP_MIB
    with httpx.Client(base_url=service.url, trust_env=False) as client:
        assert client.get("/readyz").status_code == 200
