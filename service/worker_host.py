"""The workers of a machine without a gateway: beside those of others on one PostgreSQL."""

from __future__ import annotations

import asyncio
import signal

import structlog

from revisit.service.composition import STOP_SIGNALS, build_context, supervisor_name
from revisit.service.settings import Settings
from revisit.service.supervised import READY, STOPPING, tell_supervisor
from revisit.service.worker.supervisor import WorkerSupervisor

log = structlog.get_logger(__name__)


def run_workers(settings: Settings) -> int:
    """Keep the workers of this machine alive until SIGTERM or SIGINT; the exit status."""
    return asyncio.run(_run(settings))


async def _run(settings: Settings) -> int:
    stop = asyncio.Event()
    for number in STOP_SIGNALS:
        asyncio.get_running_loop().add_signal_handler(signal.Signals(number), stop.set)
    context = build_context(settings, gateway=False)
    name = supervisor_name(settings, "workers")
    supervisor = WorkerSupervisor(context.storage, context.policy.lease_ms, settings.workers, name)
    await supervisor.take_over()
    supervisor.start()
    tell_supervisor(READY)
    await stop.wait()
    log.info("draining")
    tell_supervisor(STOPPING)
    await supervisor.stop(settings.for_tests.drain_s)
    await asyncio.to_thread(context.transactions.close)
    log.info("stopped", status=0)
    return 0
