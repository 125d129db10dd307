"""A worker process: claim, run, commit, again; with a heartbeat beside it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import structlog

from revisit.core.errors import ErrorCode
from revisit.service.application.contract.context import Context
from revisit.service.application.contract.errors import Unavailable
from revisit.service.application.contract.origin import NoTracer, Origin, Role, Tracer, originating
from revisit.service.application.contract.ports import Lease, UnitOfWork
from revisit.service.application.contract.records import JobRecord
from revisit.service.application.housekeeping.dead_letters import mark_subject_failed
from revisit.service.application.recognise.recognition import Recognition
from revisit.service.worker.confinement import resident_bytes
from revisit.service.worker.heartbeat import Heartbeat, WorkerIdentity

IDLE_POLL_S = 0.1

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class WorkerLimits:
    """When a worker makes room for a fresh one: after `jobs`, or once it holds `recycled_at_bytes` between two jobs.

    A job that takes longer than `job_timeout_s` ends its worker.
    """

    jobs: int
    recycled_at_bytes: int
    job_timeout_s: float


class Worker:
    """Runs jobs one after another until `stopping` is set or a limit is reached."""

    def __init__(
        self,
        context: Context,
        recognition: Recognition,
        identity: WorkerIdentity,
        stopping: threading.Event,
        limits: WorkerLimits,
        tracer: Tracer = NoTracer(),
    ) -> None:
        """`recognition` runs the jobs."""
        self._context = context
        self._recognition = recognition
        self._identity = identity
        self._stopping = stopping
        self._last_tenant = ""
        self._limits = limits
        self._tracer = tracer
        self._heartbeat = Heartbeat(context, recognition, identity, limits.job_timeout_s)

    def run(self) -> None:
        """Work until told to stop; a job that was begun is finished."""
        done = 0
        with self._heartbeat:
            while not self._stopping.is_set() and not self._used_up(done):
                lease = self._claim()
                if lease is None:
                    self._stopping.wait(IDLE_POLL_S)
                    continue
                self._last_tenant = lease.job.tenant
                self._run(lease)
                done += 1
        log.info("worker_stopped", jobs=done)

    def _used_up(self, done: int) -> bool:
        """Whether the worker has run enough jobs, or has kept so much memory of them that a fresh one is better."""
        held = resident_bytes()
        if done and held >= self._limits.recycled_at_bytes:
            log.info("worker_recycled", resident_mb=held >> 20, jobs=done)
            return True
        return done >= self._limits.jobs

    def _run(self, lease: Lease) -> None:
        with self._origin(lease.job):
            self._heartbeat.hold(lease)
            try:
                self._recognition.run(lease)
            except Unavailable as error:
                # The lease runs out and the job is claimed again; its attempt is counted.
                log.warning("job_end_not_stored", reason=error.message)
            finally:
                self._heartbeat.let_go()
            log.info("job_ended", kind=lease.job.kind, subject=lease.job.subject)

    @contextmanager
    def _origin(self, job: JobRecord) -> Iterator[None]:
        """A span within the trace of the request that the job came from; ids in each line of the log."""
        about: dict[str, str | int] = {"revisit.operation": job.operation_id, "revisit.attempt": job.attempts}
        ids = {"tenant": job.tenant, "operation": job.operation_id, "attempt": job.attempts}
        with (
            self._tracer.span(Role.JOB, job.kind, job.traceparent, about) as span,
            originating(Origin(job.request_id, span)),
            structlog.contextvars.bound_contextvars(**ids),
        ):
            yield

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
            return uow.queue.claim(self._identity.worker_id, now, self._last_tenant)

        try:
            if not self._context.transactions.read(waiting).result():
                return None
            return self._context.transactions.write(claim).result()
        except Unavailable as error:
            log.warning("claim_failed", reason=error.message)
            return None
