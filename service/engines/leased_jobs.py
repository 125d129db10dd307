"""The job queue: leases, attempts and fencing tokens over the jobs of any store.

A worker leases a job and extends the lease by heartbeats. When a lease runs out, the next worker takes the job with a
higher fencing token, and later reports of the first one are refused. A job without attempts left is a dead letter.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Protocol

from revisit.core.errors import ErrorCode
from revisit.service.domain.errors import StaleLease
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import JobRecord
from revisit.service.domain.states import OperationState
from revisit.service.engines.fair_turns import FairTurns
from revisit.service.ports.clock import Clock, Instant
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.repositories import JobRepository

RETRY_DELAY_MS = 500

MOST_FORGIVEN = 20
"""Runs of a job that may end for a reason that seems none of its own. A job that ends its worker in such a way every
time is poison all the same: from then on its runs count."""

STARTED_AGAIN = "the service was ended"
"""Why a run did not come back that was under way then."""


class LeasableJobs(JobRepository, Protocol):
    """Jobs with their leases, across tenants."""

    def next_runnable(self, now: Instant, tenant: TenantId) -> JobRecord | None:
        """A job that is queued and due, or has an expired lease and attempts left: the most urgent, then oldest."""
        ...

    def exhausted(self, now: Instant) -> list[JobRecord]:
        """Jobs running on a lease that has run out, with no attempts left."""
        ...

    def leased_to(self, owner: str | None) -> list[JobRecord]:
        """The running jobs of a worker, or of all."""
        ...


class LeasedJobs:
    """`JobQueue` over `LeasableJobs`, inside their transaction."""

    def __init__(self, jobs: LeasableJobs, turns: FairTurns, lease_ms: int, clock: Clock) -> None:
        """A lease lasts `lease_ms` milliseconds from its start or its last heartbeat; `turns` orders the tenants."""
        self._jobs = jobs
        self._clock = clock
        self._turns = turns
        self._lease_ms = lease_ms

    def enqueue(self, job: JobRecord, *, delay_ms: int = 0) -> JobRecord:
        """See `JobQueue`."""
        if delay_ms:
            now = self._clock.instant()
            job = replace(job, lease_epoch=now.epoch, not_before_ms=now.ms + delay_ms)
        return self._jobs.add(job)

    def waits(self) -> bool:
        """See `JobQueue`."""
        now = self._clock.instant()
        return self._next(now) is not None or bool(self._jobs.exhausted(now))

    def claim(self, owner: str) -> Lease | None:
        """See `JobQueue`."""
        now = self._clock.instant()
        job = self._next(now)
        if job is None:
            return None
        if job.state == OperationState.RUNNING:
            self._turns.end(job.tenant, job.lease_expires_ms - job.claimed_ms)
        leased = replace(
            job,
            state=OperationState.RUNNING.value,
            attempts=job.attempts + 1,
            lease_owner=owner,
            lease_token=job.lease_token + 1,
            lease_epoch=now.epoch,
            lease_expires_ms=now.ms + self._lease_ms,
            claimed_ms=now.ms,
            failure_message=None,
        )
        self._turns.begin(job.tenant)
        self._jobs.replace(leased)
        return Lease(leased)

    def require(self, lease: Lease) -> None:
        """See `JobQueue`."""
        self._held(lease)

    def extend(self, lease: Lease) -> None:
        """See `JobQueue`."""
        job, now = self._held(lease), self._clock.instant()
        self._jobs.replace(replace(job, lease_epoch=now.epoch, lease_expires_ms=now.ms + self._lease_ms))

    def report(self, lease: Lease, progress: dict[str, Any]) -> bool:
        """See `JobQueue`."""
        job = self._held(lease)
        self._jobs.replace(replace(job, progress=progress))
        return not job.cancel_requested

    def complete(self, lease: Lease, result: dict[str, Any]) -> None:
        """See `JobQueue`."""
        job = self._held(lease)
        self._turns.end(job.tenant, _ran_ms(job, self._clock.instant()))
        done, ended_ns = OperationState.DONE.value, self._clock.wall_ns()
        self._jobs.replace(replace(job, state=done, result=result, failure_message=None, finished_at_ns=ended_ns))

    def fail(self, lease: Lease, code: str, message: str, *, retry: bool, innocent: bool = False) -> bool:
        """See `JobQueue`."""
        held, now = self._held(lease), self._clock.instant()
        job = _forgiven(held) if innocent else held
        self._turns.end(job.tenant, _ran_ms(job, now))
        if retry and job.counted_attempts < job.max_attempts:
            self._jobs.replace(_queued_again(job, now))
            return False
        self._jobs.replace(_failed(job, code, message, self._clock.wall_ns()))
        return True

    def fail_exhausted_jobs(self) -> list[JobRecord]:
        """See `JobQueue`."""
        now, ended_ns = self._clock.instant(), self._clock.wall_ns()
        dead = [_failed(job, ErrorCode.INTERNAL, _last_end(job), ended_ns) for job in self._jobs.exhausted(now)]
        for job in dead:
            # The runs of a worker that was released were paid for then.
            if job.lease_expires_ms:
                self._turns.end(job.tenant, job.lease_expires_ms - job.claimed_ms)
            self._jobs.replace(job)
        return dead

    def release(self, owner: str, reason: str, *, innocent: bool = False) -> int:
        """See `JobQueue`."""
        held, now = self._jobs.leased_to(owner), self._clock.instant()
        for job in held:
            self._turns.end(job.tenant, _ran_ms(job, now))
            # One that the service forgave at its start is not forgiven twice.
            forgiven = innocent and job.failure_message is None
            ended = replace(_forgiven(job) if forgiven else job, failure_message=reason)
            # A job without attempts left stays RUNNING until `fail_exhausted_jobs`, which marks its subject too.
            spent = ended.counted_attempts >= ended.max_attempts
            again = ended if spent else _queued_again(ended, now)
            self._jobs.replace(replace(again, lease_expires_ms=0))
        return len(held)

    def forgive(self) -> int:
        """See `JobQueue`."""
        # A reason is there where the run was forgiven before, or was the last of a job that is to be buried.
        under_way = [job for job in self._jobs.leased_to(None) if job.failure_message is None]
        for job in under_way:
            self._jobs.replace(replace(_forgiven(job), failure_message=STARTED_AGAIN))
        return len(under_way)

    def _next(self, now: Instant) -> JobRecord | None:
        """The job that is to run next: the first of the first tenant, in the order of their turns, that has one."""
        found = (self._jobs.next_runnable(now, tenant) for tenant in self._turns.order())
        return next((job for job in found if job is not None), None)

    def _held(self, lease: Lease) -> JobRecord:
        """The stored job, if `lease` is still its newest. Raises StaleLease."""
        job = self._jobs.get(lease.job.tenant, lease.job.operation_id, hold=True)
        if job is None or job.state != OperationState.RUNNING or job.lease_token != lease.job.lease_token:
            raise StaleLease(f"operation {lease.job.operation_id} is no longer leased to this run")
        return job


def _ran_ms(job: JobRecord, now: Instant) -> int:
    """How long the run under way has lasted; 0 where the machine was started anew since."""
    return now.ms - job.claimed_ms if job.lease_epoch == now.epoch else 0


def _forgiven(job: JobRecord) -> JobRecord:
    """The run under way does not count against the job, unless too many have not already."""
    return job if job.forgiven >= MOST_FORGIVEN else replace(job, forgiven=job.forgiven + 1)


def _queued_again(job: JobRecord, now: Instant) -> JobRecord:
    """Back in the queue after a pause: a job that kills its workers, or takes long in vain, lets others run in between.

    The pause grows with the attempts and is no shorter than the run was.
    """
    later = now.ms + max(RETRY_DELAY_MS * job.attempts, _ran_ms(job, now))
    return replace(job, state=OperationState.QUEUED.value, lease_epoch=now.epoch, not_before_ms=later)


def _last_end(job: JobRecord) -> str:
    """The failure message of a job whose last allowed attempt did not come back."""
    reason = job.failure_message or "its lease ran out"
    return f"no worker survived the job: {job.attempts} attempts, the last one ended because {reason}"


def _failed(job: JobRecord, code: str, message: str, finished_at_ns: int) -> JobRecord:
    return replace(
        job,
        state=OperationState.FAILED.value,
        failure_code=code,
        failure_message=message,
        finished_at_ns=finished_at_ns,
    )
