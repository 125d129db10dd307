"""Robots that drive a recorded round at 1.5 m/s, and what the service and the machine do meanwhile."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import numpy as np

from revisit.sdk.credentials import Credentials
from revisit.sdk.grpc_transport import GrpcTransport
from revisit.sdk.messages import pose_json
from revisit.sdk.rest_transport import RestTransport
from revisit.sdk.retry import RetryPolicy
from revisit.sdk.transport import Forgetful
from tests.support.load import own_mib, processor_s, rss_mib
from tests.support.patience import PATIENCE_S
from tests.support.processes import ServiceProcess
from tests.support.recorded_drive import SPEED_MPS, Lap

SAMPLE_EVERY_S = 2.0
TICKS_PER_S = os.sysconf("SC_CLK_TCK")


@dataclass
class Acknowledgements(Forgetful):
    """`StreamJournal` that notes how long each scan waited for its acknowledgement, seconds."""

    took_s: list[float] = field(default_factory=list)
    _sent_s: deque[tuple[int, float]] = field(default_factory=deque)

    def sent(self, seq: int) -> None:
        """Scan `seq` is given to the stream now."""
        self._sent_s.append((seq, time.monotonic()))

    def committed(self, committed_seq: int) -> None:
        """See StreamJournal."""
        while self._sent_s and self._sent_s[0][0] <= committed_seq:
            self.took_s.append(time.monotonic() - self._sent_s.popleft()[1])


class Robot(threading.Thread):
    """Streams the scans of its first `way_m` metres, each when it is there; one that is late hurries, and leaves none
    out.
    """

    def __init__(self, target: str, session: str, lap: Lap, way_m: float, begins_s: float, *, counts: bool) -> None:
        """`target` is host:port for gRPC or a URL for REST; `begins_s` is a time of the monotonic clock.

        Where it `counts`, it tells the way up to each scan, as the SDK does.
        """
        super().__init__(name=session, daemon=True)
        self._target, self._session, self._lap, self._begins_s = target, session, lap, begins_s
        self._counts, self.scans = counts, lap.scans_within(way_m)
        self.acknowledgements = Acknowledgements()
        self.late_s: list[float] = []
        self.committed_seq, self.refusals = 0, []

    def run(self) -> None:
        """Until every scan was answered."""
        kind = RestTransport if self._target.startswith("http") else GrpcTransport
        transport = kind(self._target, RetryPolicy(), Credentials.given(None, None))
        sink = transport.open_stream(self._session, self.acknowledgements)
        for number in range(self.scans):
            way_m = self._lap.way_m(number)
            due_s = self._begins_s + way_m / SPEED_MPS
            time.sleep(max(0.0, due_s - time.monotonic()))
            cloud, T_odom_sensor = self._lap.scan(number)
            self.acknowledgements.sent(number + 1)
            pose, stamp_ns = pose_json(T_odom_sensor), int(1e9 * way_m / SPEED_MPS) + 1
            sink.send(cloud, pose, stamp_ns, way_m if self._counts else None)
            self.late_s.append(time.monotonic() - due_s)
        sink.flush()
        self.committed_seq, self.refusals = sink.committed_seq, list(sink.refusals)
        sink.close()
        transport.close()


class MachineWatch(threading.Thread):
    """Looks at queue, processor time and memory of the service every two seconds until told to stop."""

    def __init__(self, service: ServiceProcess, stop: threading.Event) -> None:
        super().__init__(name="watch", daemon=True)
        self._service, self._stopped = service, stop
        self.queued: list[int] = []
        self.gateway_s, self.workers_s, self.own_s, self._machine_s, self.took_s = 0.0, 0.0, 0.0, 0.0, 1.0
        self.gateway_mib, self.worker_mib, self.worker_own_mib = 0.0, 0.0, 0.0

    def run(self) -> None:
        """Counts what is used between the first look and the last; a worker that is replaced counts, too."""
        began_s, first_s, first_own_s = time.monotonic(), processor_s(self._service.pid), time.process_time()
        first_machine_s, cpu_s = busy_seconds(), dict[int, list[float]]()
        with httpx.Client(base_url=self._service.url, timeout=PATIENCE_S, trust_env=False) as http:
            going = True
            while going:
                going = not self._stopped.wait(SAMPLE_EVERY_S)
                self.queued.append(int(http.get("/v1/status").json()["queued_jobs"]))
                for pid in self._service.worker_pids():
                    with contextlib.suppress(FileNotFoundError, ProcessLookupError, StopIteration):
                        cpu_s.setdefault(pid, []).append(processor_s(pid))
                        self.worker_mib = max(self.worker_mib, rss_mib(pid))
                        self.worker_own_mib = max(self.worker_own_mib, own_mib(pid))
                self.gateway_mib = max(self.gateway_mib, rss_mib(self._service.pid))
        self.gateway_s = processor_s(self._service.pid) - first_s
        self.workers_s = sum(seconds[-1] - seconds[0] for seconds in cpu_s.values())
        self.own_s, self.took_s = time.process_time() - first_own_s, time.monotonic() - began_s
        self._machine_s = busy_seconds() - first_machine_s

    def other_cores(self) -> float:
        """Cores that were busy with neither the service nor the robots."""
        return (self._machine_s - self.gateway_s - self.workers_s - self.own_s) / self.took_s

    def queue_of_thirds(self) -> tuple[float, float]:
        """The mean length of the queue in the first third of the time, and in the last."""
        third = max(1, len(self.queued) // 3)
        return float(np.mean(self.queued[:third])), float(np.mean(self.queued[-third:]))


def busy_seconds() -> float:
    """Processor time of the whole machine so far, without idling and waiting for the disk."""
    user, nice, system, _, _, *rest = Path("/proc/stat").read_text().splitlines()[0].split()[1:]
    return (int(user) + int(nice) + int(system) + sum(int(ticks) for ticks in rest[:2])) / TICKS_PER_S


def stored_bytes(home: Path, kind: str) -> list[int]:
    """The sizes of the blobs of one kind."""
    return [path.stat().st_size for path in (home / "blobs").glob(f"*/{kind}/??/*")]
