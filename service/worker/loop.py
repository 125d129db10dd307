"""A worker process: claim, run, commit, again; with a heartbeat beside it that keeps the lease."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

import structlog

from core.errors import ErrorCode, RevisitError
from service.application.context import Context
from service.application.errors import StaleLease, Unavailable
from service.application.ports import Lease, UnitOfWork
from service.application.recognition import Recognition, mark_subject_failed
from service.application.records import WorkerRecord

T = TypeVar("T")

IDLE_POLL_S = 0.1
BEAT_S = 5.0
ORPHANED = 75
"""Exit status of a worker whose gateway is gone (EX_TEMPFAIL)."""

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class WorkerIdentity:
    """Who a worker is: its id, the model it runs, and the gateway that started it, if one did."""

    worker_id: str
    model_version: str
    parent_pid: int | None


class Worker:
    """Runs jobs one after another until `stopping` is set or `max_jobs` are done."""

    def __init__(
        self,
        context: Context,
        recognition: Recognition,
        identity: WorkerIdentity,
        stopping: threading.Event,
        max_jobs: int,
    ) -> None:
        """`recognition` runs the jobs."""
        self._context = context
        self._recognition = recognition
        self._identity = identity
        self._stopping = stopping
        self._max_jobs = max_jobs
        self._lease: Lease | None = None

    def run(self) -> None:
        """Work until told to stop; a job that was begun is finished."""
        done = 0
        self._beat()
        with self._heartbeat():
            while not self._stopping.is_set() and done < self._max_jobs:
                lease = self._claim()
                if lease is None:
                    self._stopping.wait(IDLE_POLL_S)
                    continue
                self._run(lease)
                done += 1
        self._commit(lambda uow: uow.workers.forget(self._identity.worker_id))
        log.info("worker_stopped", jobs=done)

    def _run(self, lease: Lease) -> None:
        with structlog.contextvars.bound_contextvars(operation=lease.job.operation_id, attempt=lease.job.attempts):
            self._lease = lease
            try:
                self._recognition.run(lease)
            except Unavailable as error:
                # The lease runs out and the job is claimed again; its attempt is counted.
                log.warning("job_end_not_stored", reason=error.message)
            finally:
                self._lease = None
            log.info("job_ended", kind=lease.job.kind, subject=lease.job.subject)

    def _claim(self) -> Lease | None:
        """The next job, if there is one and room for its result; looks before it locks."""
        if self._context.disk.exhausted():
            return None
        now = self._context.clock.instant()

        def waiting(uow: UnitOfWork) -> bool:
            return uow.jobs.next_runnable(now) is not None or bool(uow.jobs.exhausted(now))

        def claim(uow: UnitOfWork) -> Lease | None:
            for job in uow.queue.bury(now, self._context.clock.wall_ns()):
                mark_subject_failed(uow, job, ErrorCode.INTERNAL, job.failure_message or "")
            return uow.queue.claim(self._identity.worker_id, now)

        try:
            return self._commit(claim) if self._context.transactions.read(waiting).result() else None
        except Unavailable as error:
            log.warning("claim_failed", reason=error.message)
            return None

    def _commit(self, work: Callable[[UnitOfWork], T]) -> T:
        future: Future[T] = self._context.transactions.write(work)
        return future.result()

    @contextmanager
    def _heartbeat(self) -> Iterator[None]:
        """Beat beside the work; end the process when its gateway is gone."""
        ended = threading.Event()
        interval_s = min(self._context.policy.lease_ms / 4000, 0.5)
        thread = threading.Thread(target=self._keep_alive, args=(ended, interval_s), name="heartbeat", daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()

    def _keep_alive(self, ended: threading.Event, interval_s: float) -> None:
        extend_every = max(1, round(self._context.policy.lease_ms / 4000 / interval_s))
        beat_every = max(1, round(BEAT_S / interval_s))
        turn = 0
        while not ended.wait(interval_s):
            turn += 1
            if self._identity.parent_pid is not None and os.getppid() != self._identity.parent_pid:
                os._exit(ORPHANED)
            try:
                if turn % extend_every == 0:
                    self._extend()
                if turn % beat_every == 0:
                    self._beat()
            except RevisitError as error:
                log.warning("heartbeat_failed", reason=error.message)

    def _extend(self) -> None:
        lease = self._lease
        if lease is None:
            return
        now = self._context.clock.instant()
        try:
            self._commit(lambda uow: uow.queue.extend(lease, now))
        except StaleLease:
            if self._lease is lease:
                log.warning("lease_lost", operation=lease.job.operation_id)

    def _beat(self) -> None:
        now = self._context.clock.instant()
        identity = self._identity
        worker = WorkerRecord(identity.worker_id, identity.model_version, now.epoch, now.ms)
        self._commit(lambda uow: uow.workers.beat(worker))
