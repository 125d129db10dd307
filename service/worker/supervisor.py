"""The gateway's watch over its worker processes: start them, start them again, stop them."""

from __future__ import annotations

import asyncio
import os
import secrets
import signal
import sys
from asyncio.subprocess import Process
from contextlib import suppress
from pathlib import Path

import structlog

from service import ONE_THREAD
from service.application.context import Context
from service.application.errors import Unavailable
from service.application.ports import UnitOfWork

RESPAWN_S = (0.1, 2.0)
STEADY_S = 30.0
"""A worker that lived this long is replaced at once; one that keeps dying waits longer, at most 2 s."""

log = structlog.get_logger(__name__)


class WorkerSupervisor:
    """Keeps `count` worker processes alive. They are started afresh (never forked) with one thread each."""

    def __init__(self, context: Context, count: int) -> None:
        """Leases of a dead worker are released through `context`."""
        self._context = context
        self._tasks: list[asyncio.Task[None]] = []
        self._processes: set[Process] = set()
        self._stopping = False
        self._count = count

    def start(self) -> None:
        """Start the workers; returns at once."""
        self._tasks = [asyncio.create_task(self._keep_running(), name=f"worker-{n}") for n in range(self._count)]

    async def stop(self, timeout_s: float) -> None:
        """Let the workers finish their jobs for `timeout_s`, then end them; their jobs stay queued."""
        self._stopping = True
        self._signal_all(signal.SIGTERM)
        if not self._tasks:
            return
        _, late = await asyncio.wait(self._tasks, timeout=timeout_s)
        self._signal_all(signal.SIGKILL)
        for task in late:
            await task

    def _signal_all(self, number: signal.Signals) -> None:
        for process in tuple(self._processes):
            # It may have ended by itself a moment ago.
            with suppress(ProcessLookupError):
                process.send_signal(number)

    async def _keep_running(self) -> None:
        pause_s = RESPAWN_S[0]
        while not self._stopping:
            started = asyncio.get_running_loop().time()
            try:
                await self._run_once()
            except OSError as error:
                # No process or file handle is free just now: what else runs here may give some back.
                log.error("worker_not_started", reason=error.strerror)
            lived_s = asyncio.get_running_loop().time() - started
            pause_s = RESPAWN_S[0] if lived_s > STEADY_S else min(pause_s * 2, RESPAWN_S[1])
            if not self._stopping:
                await asyncio.sleep(pause_s)

    async def _run_once(self) -> None:
        """Run one worker process to its end, and let go of what it held."""
        worker_id = f"worker-{secrets.token_hex(4)}"
        arguments = ("worker", "--id", worker_id, "--parent", str(os.getpid()))
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "service", *arguments, env=_environment(), stdin=asyncio.subprocess.DEVNULL
        )
        self._processes.add(process)
        if self._stopping:
            self._signal_all(signal.SIGTERM)
        status = await process.wait()
        self._processes.discard(process)
        log.info("worker_ended", worker=worker_id, pid=process.pid, status=status)
        await self._release(worker_id)

    async def _release(self, worker_id: str) -> None:
        try:
            released = await self._context.write(lambda uow: _bury(uow, worker_id))
        except Unavailable as error:
            log.warning("leases_not_released", worker=worker_id, reason=error.message)
            return
        if released:
            log.warning("worker_died_at_work", worker=worker_id)


def _bury(uow: UnitOfWork, worker_id: str) -> int:
    """Forget a dead worker; how many jobs it held."""
    uow.workers.forget(worker_id)
    return uow.queue.release(worker_id)


def _environment() -> dict[str, str]:
    """The gateway's environment, in which `service` can be found from any directory."""
    root = str(Path(__file__).resolve().parents[2])
    path = os.environ.get("PYTHONPATH")
    return {
        **os.environ,
        **ONE_THREAD,
        "MALLOC_ARENA_MAX": "2",
        "PYTHONPATH": root if path is None else f"{root}{os.pathsep}{path}",
    }
