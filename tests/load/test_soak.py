"""Hours of mixed traffic at a load that the service bears well (P23): memory, files, threads and the log stay flat.

REVISIT_SOAK_MINUTES (60) after a warm-up of REVISIT_SOAK_WARM_UP_MINUTES (30): for about so long the heap of a process
takes on the pages that its traffic needs, in steps. What is stored stays as much as it is, for clients delete what is
old: an index that grows with its submaps would be no leak.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import threading
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import httpx
import numpy as np
import pytest

from revisit import Client
from revisit.formats import encode_quantised
from tests.support.figures import publish
from tests.support.load import CALLS, OK, SESSION, Call, Sender, Tally, rss_mib, run_for
from tests.support.processes import ServiceProcess
from tests.support.service_world import cloud_points, pose

MINUTES = float(os.environ.get("REVISIT_SOAK_MINUTES", "60"))
WARM_UP_MINUTES = float(os.environ.get("REVISIT_SOAK_WARM_UP_MINUTES", "30"))
pytestmark = [pytest.mark.slow, pytest.mark.timeout(int(60 * (MINUTES + WARM_UP_MINUTES)) + 600)]

POINTS = 2_000
CAPACITY_PER_S = 20.0
LOAD_SHARE = 0.6
KEPT_SUBMAPS = 100
KEPT_DRIVES = 5
SAMPLE_EVERY_S = 2.0
FEWEST_SAMPLES = 5
MOST_MIB_PER_HOUR = 1.0
MOST_WAL_MIB = 64.0
SHORTEST_FOR_SLOPE_H = 0.5
"""A slope over less is noise: below, memory need only stay within `NOISE_MIB` of itself."""
NOISE_MIB = 32.0
MOST_MORE = 16
"""Files and threads beyond those of the first sample: pools grow to their bounds."""


@dataclass(frozen=True)
class Sample:
    """A process at one time: MiB of memory, open files, threads; and the size of the database's log."""

    at_s: float
    rss_mib: float
    files: int
    threads: int
    wal_mib: float


class Sampler(threading.Thread):
    """Looks at the gateway and its workers again and again."""

    def __init__(self, service: ServiceProcess, wal: Path, stop: threading.Event) -> None:
        super().__init__(name="sampler", daemon=True)
        self._service, self._wal, self._stopped = service, wal, stop
        self.samples: dict[int, list[Sample]] = {}

    def run(self) -> None:
        """Until told to stop. A worker that is replaced meanwhile counts as a process of its own."""
        while not self._stopped.wait(SAMPLE_EVERY_S):
            for pid in (self._service.pid, *self._service.worker_pids()):
                with contextlib.suppress(FileNotFoundError):
                    self.samples.setdefault(pid, []).append(self._sample(pid))

    def _sample(self, pid: int) -> Sample:
        process = Path(f"/proc/{pid}")
        files, threads = len(list((process / "fd").iterdir())), len(list((process / "task").iterdir()))
        return Sample(time.monotonic(), round(rss_mib(pid), 1), files, threads, self._wal.stat().st_size / 2**20)


def mib_per_hour(samples: list[Sample]) -> float:
    """The slope of the memory, least squares."""
    at_h = np.array([sample.at_s / 3600.0 for sample in samples])
    return float(np.polyfit(at_h - at_h[0], [sample.rss_mib for sample in samples], 1)[0])


def keeping_few(call: Call, client: Client) -> Call:
    """As `call`, which posts a submap, and deletes the oldest of its submaps once there are enough."""
    posted: deque[str] = deque()

    def post(submap_id: str) -> str:
        outcome = call(submap_id)
        posted.append(submap_id)
        if len(posted) > KEPT_SUBMAPS:
            client.delete(f"{SESSION}/submaps/{posted.popleft()}")
        return outcome

    return post


def asking(http: httpx.Client) -> Call:
    """Searches and lists."""

    def ask(_: str) -> str:
        answer = http.post("/v1/maps/town/submaps:search", json={"submap": f"{SESSION}/submaps/first", "k": 5})
        listed = http.get(f"/v1/{SESSION}/submaps?page_size=10")
        return OK if (answer.status_code, listed.status_code) == (200, 200) else f"ask {answer.status_code}"

    return ask


def driving(client: Client) -> Call:
    """Streams a session of 20 scans and deletes the oldest."""
    numbers, driven = itertools.count(), deque()

    def drive(_: str) -> str:
        driven.append(client.create_session("maps/town", f"drive{next(numbers)}"))
        with client.stream(driven[-1]) as stream:
            for number in range(1, 21):
                stream.send(cloud_points(number, 300), pose(float(number)), number)
        if len(driven) > KEPT_DRIVES:
            client.delete(driven.popleft())
        return OK if stream.committed_seq == 20 else "stream"

    return drive


def traffic(service, http: httpx.Client, rpc: Client, stop: threading.Event, tally: Tally) -> list[threading.Thread]:
    """Posts over both transports, searches, lists, and a stream that starts again and again."""
    cloud = encode_quantised(cloud_points(1, POINTS))
    every_s = len(CALLS) / (LOAD_SHARE * CAPACITY_PER_S)
    posts = {name: keeping_few(call(service, cloud), rpc) for name, call in CALLS.items()}
    others = [Sender("ask", asking(http), tally, 0.5, stop), Sender("drive", driving(rpc), tally, 5.0, stop)]
    return [*(Sender(name, post, tally, every_s, stop) for name, post in posts.items()), *others]


def soak(service, home: Path) -> tuple[Tally, dict[int, list[Sample]], float]:
    """Answers, all samples, and the MiB of the log at most; the samples are those after the warm-up."""
    tally, stop = Tally(), threading.Event()
    sampler = Sampler(service, home / "revisit.db-wal", stop)
    warm_s = time.monotonic() + 60 * WARM_UP_MINUTES
    http = httpx.Client(base_url=service.url, trust_env=False, timeout=30)
    with http, Client.grpc(service.grpc_target) as rpc:
        session = rpc.create_session(rpc.create_map("town"), "monday")
        rpc.wait(rpc.post_submap(session, "first", cloud_points(1), pose(), 1), 60.0)
        run_for(60 * (WARM_UP_MINUTES + MINUTES), stop, sampler, *traffic(service, http, rpc, stop, tally))
    most_wal_mib = max(sample.wal_mib for samples in sampler.samples.values() for sample in samples)
    warm = {pid: [s for s in samples if s.at_s >= warm_s] for pid, samples in sampler.samples.items()}
    return tally, {pid: samples for pid, samples in warm.items() if len(samples) >= FEWEST_SAMPLES}, most_wal_mib


def test_nothing_grows_while_the_load_stays_the_same(tmp_path):
    # A worker that is replaced takes its leaks along.
    settings = {"workers": 1, "jobs_per_worker": 10**9, "fake_delay_s": 0.5 / CAPACITY_PER_S}
    service = ServiceProcess(tmp_path / "home", **settings)
    try:
        tally, processes, most_wal_mib = soak(service, tmp_path / "home")
    finally:
        service.close()
    slopes = {pid: round(mib_per_hour(samples), 2) for pid, samples in processes.items()}
    spans = {
        field: {pid: [getattr(s[0], field), max(getattr(x, field) for x in s)] for pid, s in processes.items()}
        for field in ("rss_mib", "files", "threads")
    }
    sizes = {"first_and_most": spans, "mib_per_hour": slopes, "most_wal_mib": round(most_wal_mib, 1)}
    publish("soak", promise="P23", minutes=MINUTES, gateway=service.pid, answers=tally.counts(), **sizes)
    assert tally.others(OK) == {}
    assert len(processes) == 2 and service.pid in processes
    assert most_wal_mib <= MOST_WAL_MIB
    for pid in processes:
        first_mib, most_mib = spans["rss_mib"][pid]
        assert most_mib - first_mib <= NOISE_MIB
        assert slopes[pid] <= MOST_MIB_PER_HOUR or MINUTES / 60 < SHORTEST_FOR_SLOPE_H
        for field in ("files", "threads"):
            assert spans[field][pid][1] <= spans[field][pid][0] + MOST_MORE
