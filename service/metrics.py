"""Metrics in Prometheus format: requests as they are answered, the store as it stands when asked."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator
from enum import StrEnum
from typing import Any

import structlog
from prometheus_client import CollectorRegistry, Gauge, Histogram, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from revisit.core.errors import RevisitError
from revisit.service.capacity.in_flight import InFlight
from revisit.service.context import ServiceContext
from revisit.service.domain.states import LoopState, OperationState, SubmapState
from revisit.service.features.upkeep.calls import WORKER_SEEN_WITHIN_MS
from revisit.service.ports.repositories import Repository
from revisit.service.ports.transactions import UnitOfWork

LATENCY_BUCKETS_S = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0)
LAG_BUCKETS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 1.0)
LAG_EVERY_S = 0.05
LAG_BOUND_S = 0.1
"""A loop that is later than this keeps health checks and acknowledgements waiting: it is logged."""

LOOPBACK = "127.0.0.1"
LOOPBACK_NAMES = frozenset({LOOPBACK, "localhost"})

log = structlog.get_logger(__name__)


class RequestMetrics:
    """How long requests took, by transport, call and status."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry(auto_describe=True)
        self._durations = Histogram(
            "revisit_request_duration_seconds",
            "Time from a request to the end of its answer.",
            ("transport", "call", "status"),
            registry=self.registry,
            buckets=LATENCY_BUCKETS_S,
        )

    def observe(self, transport: str, call: str, status: str, duration_s: float) -> None:
        """Count one answered request; `call` is a route or an RPC, never a client's free text."""
        self._durations.labels(transport, call, status).observe(duration_s)


class LoadMetrics:
    """How late the event loop is (everything waits as long); clouds and streams that are taken in now."""

    def __init__(self, registry: CollectorRegistry, in_flight: InFlight) -> None:
        self._lag = Histogram(
            "revisit_event_loop_lag_seconds",
            "How late the gateway's event loop wakes, looked at every 50 ms.",
            registry=registry,
            buckets=LAG_BUCKETS_S,
        )
        clouds = Gauge("revisit_clouds_in_intake", "Clouds that are being decoded and stored.", registry=registry)
        clouds.set_function(lambda: in_flight.clouds)
        streams = Gauge("revisit_open_streams", "Streams of scans that are open.", registry=registry)
        streams.set_function(lambda: in_flight.streams)

    async def watch(self) -> None:
        """Measure until cancelled; write down each time that the loop was later than it may be."""
        while True:
            began_s = time.perf_counter()
            await asyncio.sleep(LAG_EVERY_S)
            lag_s = max(0.0, time.perf_counter() - began_s - LAG_EVERY_S)
            self._lag.observe(lag_s)
            if lag_s > LAG_BOUND_S:
                log.warning("event_loop_late", lag_s=round(lag_s, 3))


class StoreMetrics(Collector):
    """Jobs, submaps and loop closures by state, and workers alive, read from the database for each answer."""

    def __init__(self, context: ServiceContext) -> None:
        """Reads from `context`, from the thread that answers."""
        self._context = context

    def collect(self) -> Iterator[Metric]:
        """The families; only that of the index where the database does not answer."""
        drift = CounterMetricFamily("revisit_index_drift", "Submaps of the index that differed from the database.")
        drift.add_metric([], self._context.index_health.drift)
        yield drift
        try:
            counts = self._context.transactions.read(self._count).result()
        except RevisitError:
            return
        for name, (help_text, label, values) in counts.items():
            family = GaugeMetricFamily(name, help_text, labels=[label] if label else [])
            for value, count in values.items():
                family.add_metric([value] if label else [], count)
            yield family

    def _count(self, uow: UnitOfWork) -> dict[str, tuple[str, str, dict[str, int]]]:
        tables: dict[str, tuple[str, Repository[Any], type[StrEnum]]] = {
            "revisit_jobs": ("Jobs by state.", uow.jobs, OperationState),
            "revisit_submaps": ("Submaps by state.", uow.submaps, SubmapState),
            "revisit_loop_closures": ("Judged pairs of submaps by verdict.", uow.loops, LoopState),
        }
        counts = {
            name: (text, "state", {state.value: table.count_of_all_tenants(state=state.value) for state in states})
            for name, (text, table, states) in tables.items()
        }
        alive = uow.workers.alive(WORKER_SEEN_WITHIN_MS)
        oldest_ns, now_ns = uow.jobs.oldest_queued_ns(), self._context.clock.wall_ns()
        waits_s = 0 if oldest_ns is None else max(0, now_ns - oldest_ns) // 10**9
        return {
            **counts,
            "revisit_workers": ("Workers that have shown themselves lately.", "", {"": len(alive)}),
            "revisit_oldest_queued_job_seconds": ("How long the oldest queued job has waited.", "", {"": waits_s}),
            "revisit_wal_bytes": (
                "Size of the database's write-ahead log.",
                "",
                {"": self._context.disk.wal_bytes()},
            ),
        }


class MetricsServer:
    """`/metrics` on a loopback port of its own, in a thread of its own."""

    def __init__(self, requests: RequestMetrics, store: StoreMetrics, port: int) -> None:
        """Listens at once; `port` 0 takes a free one. Raises OSError where the port is taken."""
        requests.registry.register(store)
        self._server, self._thread = start_http_server(port, addr=LOOPBACK, registry=requests.registry)
        self._server.set_app(_guarded(self._server.get_app()))

    @property
    def port(self) -> int:
        """The port it listens on."""
        return int(self._server.server_port)

    def close(self) -> None:
        """Stop answering."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def _guarded(answer: Any) -> Callable[..., Any]:
    """Answers only where it is addressed as loopback, so that no page can read it under a name of its own."""

    def guarded(environ: dict[str, Any], start_response: Callable[..., Any]) -> Any:
        if environ.get("HTTP_HOST", "").rpartition(":")[0] in LOOPBACK_NAMES:
            return answer(environ, start_response)
        start_response("403 Forbidden", [("Content-Type", "text/plain")])
        return [b"The metrics are not known under this name.\n"]

    return guarded
