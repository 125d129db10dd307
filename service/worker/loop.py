"""A worker process: claim, run, commit, again; with a heartbeat beside it."""

from __future__ import annotations

import random
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import structlog

from revisit.core.errors import DataLoss
from revisit.service.context import ServiceContext
from revisit.service.domain.errors import Unavailable
from revisit.service.domain.records import JobRecord
from revisit.service.features.operations.claiming import JobClaims
from revisit.service.features.operations.job_runner import JobRunner
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.tracing import NoTracer, RequestContext, Role, Tracer, within_request
from revisit.service.worker.confinement import resident_bytes
from revisit.service.worker.free_memory import FreeMemory
from revisit.service.worker.heartbeat import Heartbeat, WorkerIdentity

IDLE_POLL_S = 0.1
MOST_POLL_S = 0.5
"""A worker asks for a job again after the first of these; of a server that many ask, after more and more up to the
last, each at another moment. Nothing tells a worker of a new job: commits would wait for each other."""

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
        context: ServiceContext,
        jobs: JobRunner,
        identity: WorkerIdentity,
        stopping: threading.Event,
        limits: WorkerLimits,
        tracer: Tracer = NoTracer(),
    ) -> None:
        """`jobs` runs leased jobs."""
        self._claims = JobClaims(context.transactions, context.disk, context.blob_outage, identity.worker_id)
        self._transactions = context.transactions
        self._jobs = jobs
        self._identity = identity
        self._stopping = stopping
        self._limits = limits
        self._tracer = tracer
        self._memory = FreeMemory()
        self._heartbeat = Heartbeat(
            context.transactions,
            context.policy.lease_ms,
            jobs,
            identity,
            limits.job_timeout_s,
        )

    def run(self) -> None:
        """Work until told to stop; a job that was begun is finished."""
        done, pause_s = 0, IDLE_POLL_S
        with self._heartbeat:
            # The next gateway forgives the runs that it finds under way: an orphan must not begin one after that.
            while not (self._stopping.is_set() or self._identity.orphaned or self._used_up(done)):
                lease = self._claim()
                if lease is None:
                    self._stopping.wait(pause_s)
                    self._memory.after_waiting(pause_s)
                    pause_s = next_pause_s(pause_s, alone=self._alone)
                    continue
                self._run(lease)
                done, pause_s = done + 1, IDLE_POLL_S
        log.info("worker_stopped", jobs=done)

    @property
    def _alone(self) -> bool:
        """Whether the workers of this machine are all that ask: a shared store does not tell of commits."""
        return self._transactions.version() is not None

    def _used_up(self, done: int) -> bool:
        """Whether the worker has run enough jobs, or has kept so much memory of them that a fresh one is better."""
        held = resident_bytes()
        if done and held >= self._limits.recycled_at_bytes:
            log.info("worker_recycled", resident_mb=held >> 20, jobs=done)
            return True
        return done >= self._limits.jobs

    def _run(self, lease: Lease) -> None:
        with self._request(lease.job):
            self._heartbeat.hold(lease)
            try:
                self._jobs.run(lease)
            except (Unavailable, DataLoss) as error:
                # The lease runs out and the job is claimed again; its attempt is counted.
                log.warning("job_end_not_stored", reason=error.reason)
            finally:
                self._heartbeat.release()
                self._memory.after_job()
            log.info("job_ended", kind=lease.job.kind, subject=lease.job.subject)

    @contextmanager
    def _request(self, job: JobRecord) -> Iterator[None]:
        """A span within the trace of the request that the job came from; ids in each line of the log."""
        about: dict[str, str | int] = {"revisit.operation": job.operation_id, "revisit.attempt": job.attempts}
        ids = {"tenant": job.tenant, "operation": job.operation_id, "attempt": job.attempts}
        with (
            self._tracer.span(Role.JOB, job.kind, job.traceparent, about) as span,
            within_request(RequestContext(job.request_id, span)),
            structlog.contextvars.bound_contextvars(**ids),
        ):
            yield

    def _claim(self) -> Lease | None:
        """The next job, if there is one and the database answers."""
        try:
            return self._claims.next()
        except (Unavailable, DataLoss) as error:
            log.warning("claim_failed", reason=error.reason)
            return None


def next_pause_s(pause_s: float, *, alone: bool) -> float:
    """The pause after one of `pause_s` in which no job came."""
    return IDLE_POLL_S if alone else min(MOST_POLL_S, 1.5 * pause_s) * random.uniform(0.7, 1.0)
