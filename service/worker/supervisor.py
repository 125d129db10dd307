"""The supervisor of the worker processes: starts, restarts and stops them, and kills those that hang."""

from __future__ import annotations

import asyncio
import os
import secrets
import signal
from asyncio.subprocess import Process
from collections import Counter
from contextlib import suppress
from functools import partial

import structlog

from revisit.service import ONE_THREAD, python_subprocess
from revisit.service.domain.errors import Unavailable
from revisit.service.ports.storage import Storage
from revisit.service.ports.transactions import UnitOfWork
from revisit.service.worker.exit_status import WorkerEnd, end_of, is_innocent, out_of_memory_kills, reason_of

RESPAWN_S = (0.1, 2.0)
STEADY_S = 30.0
"""A worker that lived this long is replaced at once; one that keeps dying waits longer, at most 2 s."""

SILENT_LEASES = 3
"""A worker that has not shown itself for so many leases is ended: something in it holds every thread."""

log = structlog.get_logger(__name__)


class WorkerSupervisor:
    """Keeps `count` worker processes alive. They are started afresh (never forked) with one thread each.

    `ends` counts how they ended.
    """

    def __init__(self, storage: Storage, lease_ms: int, count: int, name: str) -> None:
        """Leases of a dead worker are released in `storage`. The ids of the workers of gateway `name` begin alike."""
        self._storage = storage
        self._family = f"worker-{name}-"
        self._lease_ms = lease_ms
        self._tasks: list[asyncio.Task[None]] = []
        self._processes: set[Process] = set()
        self._stopping = False
        self._count = count
        self.ends: Counter[WorkerEnd] = Counter(dict.fromkeys(WorkerEnd, 0))

    async def take_over(self) -> None:
        """Forgive the runs of this gateway's workers that were under way when it ended. Call it before `start`."""
        try:
            forgiven = await self._storage.write(lambda uow: uow.queue.forgive(self._family))
        except Unavailable as error:
            log.warning("runs_not_forgiven", reason=error.reason)
            return
        if forgiven:
            log.info("runs_forgiven", runs=forgiven)

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
            _send(process, number)

    async def _keep_running(self) -> None:
        pause_s = RESPAWN_S[0]
        while not self._stopping:
            started = asyncio.get_running_loop().time()
            end = WorkerEnd.FAILED
            try:
                end = await self._run_once()
            except OSError as error:
                # No process or file handle is free just now: other programs may give some back.
                log.error("worker_not_started", reason=error.strerror)
            lived_s = asyncio.get_running_loop().time() - started
            well = end is WorkerEnd.STOPPED or lived_s > STEADY_S
            pause_s = RESPAWN_S[0] if well else min(pause_s * 2, RESPAWN_S[1])
            if not self._stopping:
                await asyncio.sleep(pause_s)

    async def _run_once(self) -> WorkerEnd:
        """Run one worker process to its end, and release its leases; how it ended."""
        worker_id, killed_before = f"{self._family}{secrets.token_hex(4)}", out_of_memory_kills()
        command = python_subprocess.command(
            "-m", "revisit.service", "worker", "--id", worker_id, "--parent", str(os.getpid())
        )
        process = await asyncio.create_subprocess_exec(*command, env=_environment(), stdin=asyncio.subprocess.DEVNULL)
        self._processes.add(process)
        log.info("worker_started", worker=worker_id, pid=process.pid)
        if self._stopping:
            self._signal_all(signal.SIGTERM)
        watch = asyncio.create_task(self._end_when_silent(process, worker_id), name=f"watch-{worker_id}")
        status = await process.wait()
        self._processes.discard(process)
        watch.cancel()
        silent = watch.done() and not watch.cancelled()
        end = WorkerEnd.SILENT if silent else end_of(status)
        self.ends[end] += 1
        log.info("worker_ended", worker=worker_id, pid=process.pid, status=status, end=end.value)
        innocent = is_innocent(end, status, out_of_memory_kills() - killed_before)
        await self._release(worker_id, reason_of(end, status), innocent=innocent)
        return end

    async def _end_when_silent(self, process: Process, worker_id: str) -> None:
        """Return once the worker has stopped showing itself and was killed for it. One that still loads is left alone.

        Its own watch over a job's time needs a thread that runs: native code may keep it from doing so.
        """
        patience_ms = SILENT_LEASES * self._lease_ms
        seen, missed = False, 0
        while missed < 2:
            await asyncio.sleep(patience_ms / 3000)
            alive = await self._shows_itself(worker_id, patience_ms)
            seen = seen or alive
            missed = 0 if alive or not seen else missed + 1
        log.error("worker_silent", worker=worker_id, pid=process.pid)
        _send(process, signal.SIGKILL)

    async def _shows_itself(self, worker_id: str, within_ms: int) -> bool:
        try:
            alive = await self._storage.read(lambda uow: uow.workers.alive(within_ms))
        except Unavailable as error:
            # A database that does not answer says nothing about the worker.
            log.warning("worker_not_watched", worker=worker_id, reason=error.reason)
            return True
        return any(worker.worker_id == worker_id for worker in alive)

    async def _release(self, worker_id: str, reason: str, *, innocent: bool) -> None:
        release = partial(_release, worker_id=worker_id, reason=reason, innocent=innocent)
        try:
            released = await self._storage.write(release)
        except Unavailable as error:
            log.warning("leases_not_released", worker=worker_id, reason=error.reason)
            return
        if released:
            log.warning("worker_died_at_work", worker=worker_id, reason=reason, innocent=innocent)


def _send(process: Process, number: signal.Signals) -> None:
    # It may have ended by itself a moment ago.
    with suppress(ProcessLookupError):
        process.send_signal(number)


def _release(uow: UnitOfWork, worker_id: str, reason: str, *, innocent: bool) -> int:
    """Forget a dead worker; how many jobs it held."""
    uow.workers.forget(worker_id)
    return uow.queue.release(worker_id, reason, innocent=innocent)


def _environment() -> dict[str, str]:
    return {**python_subprocess.environment(), **ONE_THREAD, "MALLOC_ARENA_MAX": "2"}
