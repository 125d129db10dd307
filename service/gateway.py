"""The gateway process: REST and gRPC on one event loop, the worker processes, and the shutdown of all."""

from __future__ import annotations

import asyncio
import gc
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import structlog
import uvicorn
from prometheus_client import ProcessCollector

from revisit.service import VERSION
from revisit.service.chores import chores
from revisit.service.composition import (
    build_context,
    build_tracer,
    build_use_cases,
    require_bucket,
    supervisor_name,
)
from revisit.service.context import ServiceContext
from revisit.service.engines.local.files.disk import FailStop
from revisit.service.engines.state import State
from revisit.service.features.upkeep.chores import Upkeep
from revisit.service.large_blocks import return_large_blocks
from revisit.service.metrics import GatewayMetrics, LoadMetrics, MetricsServer, RequestMetrics, StoreMetrics
from revisit.service.open_files import allow_open_files
from revisit.service.settings import Settings
from revisit.service.supervised import READY, STOPPING, tell_supervisor
from revisit.service.tls import expiry_s, grpc_credentials, http_context
from revisit.service.use_cases import UseCases
from revisit.service.worker.exit_status import STORAGE_FAILED
from revisit.service.worker.metrics import WorkerMetrics
from revisit.service.worker.supervisor import WorkerSupervisor

if TYPE_CHECKING:
    import grpc.aio

SERVER_FAILED = 70
"""Exit status where a server ended without being told to (EX_SOFTWARE)."""

SWITCH_S = 0.0005
"""How long a decoding thread may hold the interpreter lock while the event loop waits for it; Python's default is 5 ms.
An answer hands over several times. Chosen by that reasoning; its effect was not measured by itself."""

FAIL_STOP_S = 0.5
"""How long the process lives after the disk has failed, so that pending answers can still go out."""

log = structlog.get_logger(__name__)


def serve(settings: Settings, state: State) -> int:
    """Run the gateway and its workers until SIGTERM or SIGINT; the exit status."""
    state.migrate()
    require_bucket(settings)
    sys.setswitchinterval(SWITCH_S)
    open_files = allow_open_files()
    return_large_blocks()
    with asyncio.Runner(loop_factory=_loop_factory()) as runner:
        return runner.run(_Gateway(settings, open_files).run())


class _Gateway:
    """One run of the gateway."""

    def __init__(self, settings: Settings, open_files: int) -> None:
        self._settings = settings
        self._open_files = open_files
        self._status = 0
        self._requests = RequestMetrics()
        self._tracer = build_tracer(settings, "gateway")

    async def run(self) -> int:
        """Serve until told to stop, then drain; the exit status."""
        stop = self._stop_signal()
        fail_stop = FailStop(self._failing_disk_ends(stop))
        context = build_context(self._settings, gateway=True, fail_stop=fail_stop)
        use_cases = build_use_cases(context, self._settings)
        supervisor = self._supervisor(context)
        http, http_port = self._http_server(use_cases)
        rpc, grpc_port = self._grpc_server(use_cases)
        await rpc.start()
        use_cases.system.reached_at(self._settings.grpc_address or f":{grpc_port}")
        serving = asyncio.create_task(http.serve(), name="http")
        await supervisor.take_over()
        supervisor.start()
        upkeep = Upkeep(chores(self._settings, context, fail_stop))
        upkeep.start()
        metrics = self._metrics_server(context)
        await asyncio.to_thread(_load_kernels)
        _look_for_garbage_again()
        self._watch_load(context)
        self._announce(http_port, grpc_port)
        tell_supervisor(READY)
        await self._warn_of_access(use_cases)
        stopped = asyncio.create_task(stop.wait(), name="stop")
        await asyncio.wait([stopped, serving], return_when=asyncio.FIRST_COMPLETED)
        if not stopped.done():
            log.error("http_server_ended")
            self._status = SERVER_FAILED
        await self._drain(use_cases, http, serving, rpc, supervisor)
        if self._status == STORAGE_FAILED:
            # All answers are out. Tidying up may hang on the disk, and taking the interpreter down takes
            # another second, during which no timer ends it.
            log.info("stopped", status=self._status)
            os._exit(self._status)
        await upkeep.stop()
        if metrics is not None:
            await asyncio.to_thread(metrics.close)
        await asyncio.to_thread(self._tracer.close)
        await asyncio.to_thread(context.transactions.close)
        log.info("stopped", status=self._status)
        return self._status

    async def _warn_of_access(self, use_cases: UseCases) -> None:
        """Tell the operator where anyone gets in, or nobody."""
        if self._settings.exposed and await use_cases.access.is_open():
            log.warning("open_to_everyone", hint="create an API key: `revisit keys create`")
        needs_key = self._settings.credential_required and not self._settings.knows_callers_without_keys
        if needs_key and not await use_cases.keys.any_live():
            log.warning("closed_to_everyone", hint="create the first API key: `revisit keys create`")

    def _supervisor(self, context: ServiceContext) -> WorkerSupervisor:
        """The supervisor of the workers; the metrics of this process and of them."""
        registry, lease_ms = self._requests.registry, context.policy.lease_ms
        name = supervisor_name(self._settings, "gateway")
        supervisor = WorkerSupervisor(context.storage, lease_ms, self._settings.workers, name)
        registry.register(WorkerMetrics(supervisor))
        ProcessCollector(namespace="revisit", registry=registry)
        return supervisor

    def _watch_load(self, context: ServiceContext) -> None:
        """Measure from now on how late the event loop is: the start keeps it busy."""
        load = LoadMetrics(self._requests.registry, context.in_flight)
        self._watch = asyncio.create_task(load.watch(), name="load")

    def _announce(self, http_port: int, grpc_port: int) -> None:
        settings = self._settings
        tls = settings.tls_certificate is not None
        log.info("listening", host=settings.host, http_port=http_port, grpc_port=grpc_port, tls=tls, pid=os.getpid())

    async def _drain(
        self,
        use_cases: UseCases,
        http: uvicorn.Server,
        serving: asyncio.Task[Any],
        rpc: grpc.aio.Server,
        supervisor: WorkerSupervisor,
    ) -> None:
        """Refuse new work, let running work end, within `drain_s` altogether."""
        log.info("draining")
        tell_supervisor(STOPPING)
        use_cases.system.drain()
        http.should_exit = True
        drain_s = self._settings.for_tests.drain_s
        await asyncio.gather(rpc.stop(grace=drain_s), serving, supervisor.stop(drain_s))

    def _failing_disk_ends(self, stop: asyncio.Event) -> Callable[[], None]:
        loop = asyncio.get_running_loop()

        def storage_failed() -> None:
            self._status = STORAGE_FAILED
            # The answer still goes out, but a hanging disk does not hold up the end.
            end = threading.Timer(FAIL_STOP_S, os._exit, (STORAGE_FAILED,))
            end.daemon = True
            end.start()
            loop.call_soon_threadsafe(stop.set)

        return storage_failed

    def _stop_signal(self) -> asyncio.Event:
        stop = asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
        return stop

    def _metrics_server(self, context: ServiceContext) -> MetricsServer | None:
        """`/metrics` on a port of its own, where the settings ask for it."""
        port = self._settings.metrics_port
        if port is None:
            return None
        host, names = self._settings.metrics_host, self._settings.host_names
        gateway = GatewayMetrics(VERSION, context.clock, expiry_s(self._settings))
        server = MetricsServer(self._requests, (StoreMetrics(context), gateway), port, host, names)
        log.info("metrics_listening", port=server.port)
        return server

    def _http_server(self, use_cases: UseCases) -> tuple[uvicorn.Server, int]:
        from revisit.service.rest.app import create_app
        from revisit.service.rest.listening import ListeningServer
        from revisit.service.rest.slow_clients import uvicorn_limits

        tls = http_context(self._settings)
        config = uvicorn.Config(
            create_app(
                use_cases,
                hosts=self._settings.host_names,
                requests=self._requests,
                tracer=self._tracer,
                described=not self._settings.exposed,
            ),
            log_config=None,
            access_log=False,
            timeout_graceful_shutdown=int(self._settings.for_tests.drain_s),
            ssl_context_factory=None if tls is None else lambda *_: tls,
            **uvicorn_limits(),
        )
        listener = _listen(self._settings.host, self._settings.http_port)
        return ListeningServer(config, listener), listener.getsockname()[1]

    def _grpc_server(self, use_cases: UseCases) -> tuple[grpc.aio.Server, int]:
        from revisit.service.grpc.open_connections import OpenConnections
        from revisit.service.grpc.server import CONNECTIONS, create_server

        open_connections = OpenConnections()
        server = create_server(
            use_cases,
            requests=self._requests,
            tracer=self._tracer,
            described=not self._settings.exposed,
            open_connections=open_connections,
            connections=min(CONNECTIONS, self._open_files // 2),
        )
        host, port = self._settings.host, self._settings.grpc_port
        address, tls = f"[{host}]:{port}" if ":" in host else f"{host}:{port}", grpc_credentials(self._settings)
        try:
            bound = server.add_insecure_port(address) if tls is None else server.add_secure_port(address, tls)
        except RuntimeError as error:
            raise OSError(f"port {port} for gRPC cannot be taken; REVISIT_GRPC_PORT names another") from error
        self._lookout = asyncio.create_task(open_connections.watch(bound), name="open-connections")
        return server, bound


def _look_for_garbage_again() -> None:
    """Objects made during the start live on. Searching them would hold up requests for 70 to 90 ms."""
    gc.freeze()
    gc.enable()


def _load_kernels() -> None:
    """Load decoders and verification, half a second, so that the first request need not wait."""
    from revisit.core.kernels import adapted_cosines
    from revisit.formats import quantised_columns

    quantised_columns.warm_up()
    adapted_cosines.warm_up()


def _listen(host: str, port: int) -> socket.socket:
    """A listening socket. Raises OSError where the port is taken."""
    from revisit.service.rest.listening import BACKLOG

    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family, backlog=BACKLOG)
    except OSError as error:
        reason = error.strerror.partition(" (")[0].lower() if error.strerror else str(error)
        raise OSError(f"port {port} for HTTP cannot be taken ({reason}); REVISIT_HTTP_PORT names another") from error


def _loop_factory() -> Callable[[], asyncio.AbstractEventLoop] | None:
    """uvloop where there is one (it doubles the rate of a gRPC stream), else asyncio's own loop."""
    try:
        import uvloop
    except ImportError:
        return None
    return uvloop.new_event_loop
