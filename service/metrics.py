"""Metrics in Prometheus format: requests as they are answered, the store as it stands when asked."""

from __future__ import annotations

import asyncio
import ipaddress
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from enum import StrEnum
from itertools import product
from typing import Any

import structlog
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from revisit.core.errors import ErrorCode, RevisitError
from revisit.service.capacity.in_flight import InFlight
from revisit.service.context import ServiceContext
from revisit.service.domain.processes import ProcessRole
from revisit.service.domain.states import LoopState, OperationState, SubmapState
from revisit.service.features.upkeep.calls import WORKER_SEEN_WITHIN_MS
from revisit.service.ports.clock import Clock
from revisit.service.ports.repositories import Repository
from revisit.service.ports.transactions import UnitOfWork

LATENCY_BUCKETS_S = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0)
LAG_BUCKETS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 1.0)
LAG_EVERY_S = 0.05
LAG_BOUND_S = 0.1
"""A loop that is later than this keeps health checks and acknowledgements waiting: it is logged."""

LOOPBACK = "127.0.0.1"
LOOPBACK_NAMES = frozenset({LOOPBACK, "localhost"})

Values = dict[str, float]
"""Values of a family by its label; under the empty name where it has none."""

log = structlog.get_logger(__name__)


class RequestMetrics:
    """How long requests took, by transport, call and status; how many were refused, by transport and reason."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry(auto_describe=True)
        self._durations = Histogram(
            "revisit_request_duration_seconds",
            "Time from a request to the end of its answer.",
            ("transport", "call", "status"),
            registry=self.registry,
            buckets=LATENCY_BUCKETS_S,
        )
        self._refused = Counter(
            "revisit_refused_calls",
            "Calls that were answered with an error, by its reason.",
            ("transport", "reason"),
            registry=self.registry,
        )
        # There from the start: a rate does not see a series that begins with its first refusal.
        for transport, reason in product(("http", "grpc"), ErrorCode):
            self._refused.labels(transport, reason.value)

    def observe(self, transport: str, call: str, status: str, duration_s: float) -> None:
        """Count one answered request; `call` is a route or an RPC, never a client's free text."""
        self._durations.labels(transport, call, status).observe(duration_s)

    def refuse(self, transport: str, reason: ErrorCode) -> None:
        """Count one refused call."""
        self._refused.labels(transport, reason.value).inc()


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
    """Jobs, submaps, loop closures, workers and room, read from the database and the disk for each answer."""

    def __init__(self, context: ServiceContext) -> None:
        """Reads from `context`, from the thread that answers."""
        self._context = context

    def collect(self) -> Iterator[Metric]:
        """The families; without those of the database where it does not answer."""
        drift = CounterMetricFamily("revisit_index_drift", "Submaps of the index that differed from the database.")
        drift.add_metric([], self._context.index_health.drift)
        yield drift
        # Of a disk that fails, and of a database that does not answer, nothing is told.
        with suppress(OSError):
            yield from self._room()
        try:
            counts = self._context.transactions.read(self._count).result()
        except RevisitError:
            return
        for name, (help_text, label, values) in counts.items():
            yield _gauge(name, help_text, values, label)

    def _room(self) -> Iterator[Metric]:
        disk = self._context.disk
        free_bytes = disk.free_bytes()
        if free_bytes is not None:
            yield _gauge("revisit_disk_free_bytes", "Room on the disk of the data folder.", {"": free_bytes})
        yield _gauge("revisit_storage_full", "1 while clients' data is refused for want of room.", {"": disk.full()})
        yield _gauge("revisit_wal_bytes", "Size of the database's write-ahead log.", {"": disk.log_bytes()})
        unreachable = bool(self._context.blob_outage.unreachable())
        yield _gauge("revisit_blobs_unreachable", "1 while the store of blobs does not answer.", {"": unreachable})
        with suppress(RevisitError):
            damaged = self._context.blobs.quarantined()
            yield _gauge("revisit_quarantined_blobs", "Damaged blobs that were put aside.", {"": damaged})

    def _count(self, uow: UnitOfWork) -> dict[str, tuple[str, str, Values]]:
        tables: dict[str, tuple[str, Repository[Any], type[StrEnum]]] = {
            "revisit_jobs": ("Jobs by state.", uow.jobs, OperationState),
            "revisit_submaps": ("Submaps by state.", uow.submaps, SubmapState),
            "revisit_loop_closures": ("Judged pairs of submaps by verdict.", uow.loops, LoopState),
        }
        counts: dict[str, tuple[str, str, Values]] = {
            name: (text, "state", {state.value: table.count_of_all_tenants(state=state.value) for state in states})
            for name, (text, table, states) in tables.items()
        }
        alive = uow.workers.alive(WORKER_SEEN_WITHIN_MS)
        processes: Values = {role.value: len(uow.processes.alive(role, WORKER_SEEN_WITHIN_MS)) for role in ProcessRole}
        waiting, now_ns = uow.jobs.waiting(), self._context.clock.wall_ns()
        oldest_ns = now_ns if waiting.oldest_queued_ns is None else waiting.oldest_queued_ns
        return {
            **counts,
            "revisit_jobs_begun_again": ("Jobs that wait or run after a lost run.", "", {"": waiting.begun_again}),
            "revisit_workers": ("Workers that have shown themselves lately.", "", {"": len(alive)}),
            "revisit_processes": ("Gateways and search processes that live.", "role", processes),
            "revisit_oldest_queued_job_seconds": (
                "How long the oldest queued job has waited.",
                "",
                {"": max(0, now_ns - oldest_ns) // 10**9},
            ),
        }


class GatewayMetrics(Collector):
    """The gateway's version, its clock, and the end of its certificate."""

    def __init__(self, version: str, clock: Clock, expires_s: float | None) -> None:
        """`expires_s` is the end of the certificate of both servers, seconds since 1970, where they use TLS."""
        self._version = version
        self._clock = clock
        self._expires_s = expires_s

    def collect(self) -> Iterator[Metric]:
        """The families."""
        yield _gauge("revisit_version", "1, under the version of the gateway.", {self._version: 1}, "version")
        yield _gauge("revisit_clock_seconds", "The clock on the wall.", {"": self._clock.wall_ns() / 1e9})
        if self._expires_s is not None:
            expires = "revisit_certificate_expiry_seconds"
            yield _gauge(expires, "When the certificate of both servers expires.", {"": self._expires_s})


def _gauge(name: str, help_text: str, values: Mapping[str, float], label: str = "") -> Metric:
    family = GaugeMetricFamily(name, help_text, labels=[label] if label else [])
    for value, amount in values.items():
        family.add_metric([value] if label else [], amount)
    return family


class MetricsServer:
    """`/metrics` on a port of its own, in a thread of its own."""

    def __init__(
        self,
        requests: RequestMetrics,
        collectors: Iterable[Collector],
        port: int,
        host: str = LOOPBACK,
        names: frozenset[str] = frozenset(),
    ) -> None:
        """Listens at once; `port` 0 takes a free one. Raises OSError where the port is taken.

        On another `host` than loopback it answers to any IP address and to `names`, too.
        """
        for collector in collectors:
            requests.registry.register(collector)
        self._server, self._thread = start_http_server(port, addr=host, registry=requests.registry)
        known = LOOPBACK_NAMES | (frozenset() if host in LOOPBACK_NAMES else names)
        self._server.set_app(_guarded(self._server.get_app(), known, any_address=host not in LOOPBACK_NAMES))

    @property
    def port(self) -> int:
        """The port it listens on."""
        return int(self._server.server_port)

    def close(self) -> None:
        """Stop answering."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def _guarded(answer: Any, names: frozenset[str], *, any_address: bool) -> Callable[..., Any]:
    """Answers only to names it knows, so that no page can read it under a name of its own."""

    def guarded(environ: dict[str, Any], start_response: Callable[..., Any]) -> Any:
        asked = environ.get("HTTP_HOST", "").rpartition(":")[0]
        if asked in names or (any_address and _is_address(asked.strip("[]"))):
            return answer(environ, start_response)
        start_response("403 Forbidden", [("Content-Type", "text/plain")])
        return [b"The metrics are not known under this name.\n"]

    return guarded


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True
