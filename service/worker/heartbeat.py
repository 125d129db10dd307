"""The heartbeat thread of a worker: it extends the lease and ends the process when a job takes too long."""

from __future__ import annotations

import os
import threading
import time
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import Self

import structlog

from revisit.core.errors import RevisitError
from revisit.service.domain.errors import StaleLease
from revisit.service.features.operations.job_runner import JobRunner
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.transactions import Transactions, UnitOfWork

BEATS_PER_LEASE = 5
"""So that a lease outlives four lost beats: every 2 s for a lease of 10 s."""

POLL_EVERY_S = 0.5

ORPHANED = 75
"""Exit status of a worker without its gateway (EX_TEMPFAIL)."""

OVERTIME = 124
"""Exit status of a worker after a job that took too long (that of timeout(1))."""

IDLE_SHARE = 0.02
"""Of a core: a job that takes less waits for something that does not come."""

MOST_WALL = 10.0
"""How many times its limit a job may take by the wall clock, however loaded the machine is."""

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class WorkerIdentity:
    """A worker's identity: its id, the product's model that it runs, and the gateway that started it, if one did."""

    worker_id: str
    model_version: str
    parent_pid: int | None

    @property
    def orphaned(self) -> bool:
        """Whether the gateway that started this worker is gone."""
        return self.parent_pid is not None and os.getppid() != self.parent_pid


class Heartbeat:
    """Beats from `with` to the end of its block. `lease` is that of the job under way."""

    def __init__(
        self,
        transactions: Transactions,
        lease_ms: int,
        jobs: JobRunner,
        identity: WorkerIdentity,
        job_timeout_s: float,
    ) -> None:
        """A job that takes longer than `job_timeout_s` (see `is_overtime`) is failed through `jobs`, and the
        process ends.
        """
        self._transactions = transactions
        self._lease_ms = lease_ms
        self._jobs = jobs
        self._identity = identity
        self._job_timeout_s = job_timeout_s
        self._lease: Lease | None = None
        self._missing: Lease | None = None  # at the last beat
        self._began_s, self._began_cpu_s = 0.0, 0.0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._keep_alive, name="heartbeat", daemon=True)

    def __enter__(self) -> Self:
        """Begin to beat."""
        self._beat()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """End; the worker is gone."""
        self._ended.set()
        self._thread.join()
        self._transactions.write(lambda uow: uow.workers.forget(self._identity.worker_id)).result()

    def hold(self, lease: Lease) -> None:
        """Keep this lease from now on."""
        self._began_s, self._began_cpu_s = time.monotonic(), time.process_time()
        self._lease = lease

    def release(self) -> None:
        """Keep no lease any more."""
        self._lease = None

    def _keep_alive(self) -> None:
        beat_every_s = self._lease_ms / 1000 / BEATS_PER_LEASE
        beaten_s = time.monotonic()
        while not self._ended.wait(min(beat_every_s, POLL_EVERY_S)):
            if self._identity.orphaned:
                os._exit(ORPHANED)
            self._end_overtime()
            if time.monotonic() - beaten_s >= beat_every_s:
                beaten_s = time.monotonic()
                self._beat_or_log()

    def _end_overtime(self) -> None:
        """Fail a job that takes too long. A hanging call cannot be stopped, so the process ends with it."""
        lease = self._lease
        wall_s, cpu_s = time.monotonic() - self._began_s, time.process_time() - self._began_cpu_s
        if lease is None or not is_overtime(wall_s, cpu_s, self._job_timeout_s):
            return
        try:
            self._jobs.fail(lease, f"the job took longer than {self._job_timeout_s:g} s")
        except RevisitError as error:
            log.warning("overtime_not_stored", operation=lease.job.operation_id, reason=error.reason)
        os._exit(OVERTIME)

    def _beat_or_log(self) -> None:
        try:
            self._beat()
        except RevisitError as error:
            log.warning("heartbeat_failed", reason=error.reason)

    def _beat(self) -> None:
        """Show that the worker lives and keep its lease, in one transaction."""
        lease = self._lease
        kept = self._transactions.write(partial(self._show, lease=lease), durable=False).result()
        missing = None if kept else lease
        # Missing once, its job may have ended a moment ago.
        if missing is not None and missing is self._missing and missing is self._lease:
            log.warning("lease_lost", operation=missing.job.operation_id)
        self._missing = missing

    def _show(self, uow: UnitOfWork, lease: Lease | None) -> bool:
        """Store the beat and extend the lease; whether the lease is still ours."""
        identity = self._identity
        uow.workers.beat(identity.worker_id, identity.model_version)
        try:
            if lease is not None:
                uow.queue.extend(lease)
        except StaleLease:
            return False
        return True


def is_overtime(wall_s: float, cpu_s: float, limit_s: float) -> bool:
    """Whether a job takes too long: its work counts, in CPU time of its process, not the load of the machine.

    A job that hardly works is held against the wall clock, and so is one that is starved for MOST_WALL times the limit.
    """
    waits = cpu_s < IDLE_SHARE * wall_s
    return wall_s >= limit_s and (cpu_s >= limit_s or waits or wall_s >= MOST_WALL * limit_s)
