"""Metrics of the workers: how their processes ended."""

from __future__ import annotations

from collections.abc import Iterator

from prometheus_client.core import CounterMetricFamily, Metric
from prometheus_client.registry import Collector

from revisit.service.worker.supervisor import WorkerSupervisor


class WorkerMetrics(Collector):
    """Ends of worker processes by their kind, since the gateway started."""

    def __init__(self, supervisor: WorkerSupervisor) -> None:
        """Reads the supervisor's counts."""
        self._supervisor = supervisor

    def collect(self) -> Iterator[Metric]:
        """One family."""
        ends = CounterMetricFamily(
            "revisit_worker_ends", "Worker processes that ended, by how they did.", labels=["end"]
        )
        for end, count in sorted(self._supervisor.ends.items()):
            ends.add_metric([end.value], count)
        yield ends
