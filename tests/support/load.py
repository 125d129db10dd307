"""Clients that keep up a rate, and what they, the service and a watch over it see meanwhile."""

from __future__ import annotations

import os
import random
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import numpy as np
from prometheus_client.parser import text_string_to_metric_families

from revisit import ApiError, Client, Cloud
from revisit.formats import QUANTISED
from revisit.sdk.retry import RetryPolicy
from tests.support.patience import PATIENCE_S
from tests.support.processes import ServiceProcess
from tests.support.service_world import pose

SESSION = "maps/town/sessions/monday"
OK = "OK"
LAG = "revisit_event_loop_lag_seconds"

Call = Callable[[str], str]
"""Sends the submap of this id once; `OK`, or the reason of the refusal."""


@dataclass
class Tally:
    """Seconds that answers took, by outcome."""

    took_s: dict[str, list[float]] = field(default_factory=dict)

    def note(self, outcome: str, seconds: float) -> None:
        """Count an answer."""
        self.took_s.setdefault(outcome, []).append(seconds)

    def counts(self) -> dict[str, int]:
        """Answers by outcome."""
        return {outcome: len(seconds) for outcome, seconds in sorted(self.took_s.items())}

    def quantile_ms(self, share: float, *outcomes: str) -> float:
        """Of the answers with one of these outcomes, milliseconds."""
        return quantile(share, [1000 * took for outcome in outcomes for took in self.took_s.get(outcome, ())])

    def others(self, *outcomes: str) -> dict[str, int]:
        """Answers that are none of these."""
        return {outcome: count for outcome, count in self.counts().items() if outcome not in outcomes}


class Sender(threading.Thread):
    """Calls at a steady rate, whatever the answers; one that is late does not make up for what it has missed."""

    def __init__(self, name: str, call: Call, tally: Tally, every_s: float, stop: threading.Event) -> None:
        super().__init__(name=name, daemon=True)
        self._call, self._tally, self._every_s, self._stopped = call, tally, every_s, stop

    def run(self) -> None:
        """Until told to stop. Begins at a moment of its own, so that not all call at once."""
        due_s, number = time.monotonic() + random.Random(self.name).uniform(0.0, self._every_s), 0
        while not self._stopped.wait(max(0.0, due_s - time.monotonic())):
            number += 1
            began_s = time.perf_counter()
            outcome = self._call(f"{self.name}-{number}")
            self._tally.note(outcome, time.perf_counter() - began_s)
            due_s = max(due_s + self._every_s, time.monotonic() - self._every_s)


@dataclass(frozen=True)
class Address:
    """Where a service listens, for clients in another process than the one that has started it."""

    url: str
    grpc_target: str


def rest_call(service: ServiceProcess | Address, cloud: bytes, key: str = "") -> Call:
    """Posts a quantised cloud over REST, on a connection of its own that stays open."""
    headers = {"content-type": QUANTISED, **({"authorization": f"Bearer {key}"} if key else {})}
    client = httpx.Client(base_url=service.url, timeout=PATIENCE_S, trust_env=False, headers=headers)

    def call(submap_id: str) -> str:
        params = {"submap_id": submap_id, "stamp_ns": 1, "T_odom_submap": "0,0,0,0,0,0,1"}
        try:
            answer = client.post(f"/v1/{SESSION}/submaps", params=params, content=cloud)
        except httpx.HTTPError as error:
            return type(error).__name__
        return OK if answer.status_code == 202 else str(answer.json()["reason"])

    return call


def grpc_call(service: ServiceProcess | Address, cloud: bytes, key: str = "") -> Call:
    """As `rest_call`, over gRPC."""
    client = Client.grpc(service.grpc_target, api_key=key or None, retry=RetryPolicy(attempts=1))

    def call(submap_id: str) -> str:
        try:
            client.post_submap(SESSION, submap_id, Cloud(cloud, QUANTISED), pose(), 1)
        except ApiError as error:
            return error.reason or error.code
        return OK

    return call


CALLS = {"rest": rest_call, "grpc": grpc_call}


class Watch(threading.Thread):
    """Looks at the service several times a second: memory of the gateway, the queue, and how long /livez takes."""

    def __init__(self, service: ServiceProcess, stop: threading.Event) -> None:
        super().__init__(name="watch", daemon=True)
        self._service, self._stopped = service, stop
        self.rss_mib, self.queued, self.livez = 0.0, 0, Tally()

    def run(self) -> None:
        """Until told to stop."""
        with httpx.Client(base_url=self._service.url, timeout=PATIENCE_S, trust_env=False) as client:
            while not self._stopped.wait(0.2):
                self.rss_mib = max(self.rss_mib, rss_mib(self._service.pid))
                began_s = time.perf_counter()
                answer = client.get("/livez")
                self.livez.note(str(answer.status_code), time.perf_counter() - began_s)
                self.queued = max(self.queued, int(client.get("/v1/status").json()["queued_jobs"]))


class Served:
    """What a service with a port for its metrics says about itself from now on, without what its clients wait for."""

    def __init__(self, service: ServiceProcess) -> None:
        self._service, self._events, self._lag = service, len(service.events), _lag_buckets(service)

    def took_ms(self, share: float, *statuses: str) -> float:
        """A quantile of the time from a request's head to its answer, by its log."""
        entries = (entry for entry in self._service.events[self._events :] if entry["event"] == "request")
        return quantile(share, [entry["took_ms"] for entry in entries if str(entry["status"]) in statuses])

    def lag_ms(self, share: float) -> float:
        """A quantile of how late the event loop was: the bound of the histogram's bucket that it falls into."""
        counts = {bound: count - self._lag[bound] for bound, count in _lag_buckets(self._service).items()}
        most = max(counts.values())
        return 1000 * min(bound for bound, count in counts.items() if count >= share * most)

    def most_lag_ms(self) -> float:
        """The longest time that the event loop was late, of those above 100 ms, which are logged; else 0."""
        entries = (entry for entry in self._service.events[self._events :] if entry["event"] == "event_loop_late")
        return 1000 * max((float(entry["lag_s"]) for entry in entries), default=0.0)


def quantile(share: float, numbers: list[float]) -> float:
    """To a tenth; 0 of none."""
    return round(float(np.quantile(numbers, share)), 1) if numbers else 0.0


def rss_mib(pid: int) -> float:
    """What a process holds of the memory, MiB."""
    return _held_mib(pid, "VmRSS")


def own_mib(pid: int) -> float:
    """As `rss_mib`, without what it shares with others: the pages of files."""
    return _held_mib(pid, "RssAnon")


def _held_mib(pid: int, kind: str) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    return int(next(line for line in status.splitlines() if line.startswith(kind)).split()[1]) / 1024


def processor_s(pid: int) -> float:
    """Processor time that a process has taken, seconds."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def run_for(seconds: float, stop: threading.Event, *threads: threading.Thread) -> None:
    """Start the threads, let them work for so long, and wait for their ends."""
    for thread in threads:
        thread.start()
    stop.wait(seconds)
    stop.set()
    for thread in threads:
        thread.join(PATIENCE_S)
        assert not thread.is_alive(), f"{thread.name} hangs"


def _lag_buckets(service: ServiceProcess) -> dict[float, float]:
    """How often the event loop was late by at most so many seconds."""
    port = service.wait_for("metrics_listening")["port"]
    text = httpx.get(f"http://127.0.0.1:{port}/metrics", trust_env=False, timeout=PATIENCE_S).text
    family = next(family for family in text_string_to_metric_families(text) if family.name == LAG)
    return {float(s.labels["le"]): s.value for s in family.samples if s.name == f"{LAG}_bucket"}
