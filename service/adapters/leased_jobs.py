"""The job queue: leases, attempts and fencing tokens over the jobs of any store.

A worker leases a job and extends the lease by heartbeats. When a lease runs out, the next worker takes the job with a
higher fencing token, and what the first one still reports is refused. A job without attempts left is a dead letter.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from revisit.core.errors import ErrorCode
from revisit.service.application.contract.clock import Instant
from revisit.service.application.contract.errors import StaleLease
from revisit.service.application.contract.job_queue import Lease
from revisit.service.application.contract.records import JobRecord
from revisit.service.application.contract.repositories import JobRepository
from revisit.service.application.contract.states import OperationState

RETRY_DELAY_MS = 500


class LeasedJobs:
    """`JobQueue` over a `JobRepository`, inside whatever transaction that belongs to."""

    def __init__(self, jobs: JobRepository, lease_ms: int) -> None:
        """A lease lasts `lease_ms` milliseconds from its start or its last heartbeat."""
        self._jobs = jobs
        self._lease_ms = lease_ms

    def enqueue(self, job: JobRecord) -> JobRecord:
        """See `JobQueue`."""
        return self._jobs.add(job)

    def claim(self, owner: str, now: Instant, after: str = "") -> Lease | None:
        """See `JobQueue`."""
        job = self._jobs.next_runnable(now, after)
        if job is None:
            return None
        leased = replace(
            job,
            state=OperationState.RUNNING.value,
            attempts=job.attempts + 1,
            lease_owner=owner,
            lease_token=job.lease_token + 1,
            lease_epoch=now.epoch,
            lease_expires_ms=now.ms + self._lease_ms,
            failure_message=None,
        )
        self._jobs.replace(leased)
        return Lease(leased)

    def require(self, lease: Lease) -> None:
        """See `JobQueue`."""
        self._held(lease)

    def extend(self, lease: Lease, now: Instant) -> None:
        """See `JobQueue`."""
        job = self._held(lease)
        self._jobs.replace(replace(job, lease_epoch=now.epoch, lease_expires_ms=now.ms + self._lease_ms))

    def complete(self, lease: Lease, result: dict[str, Any], finished_at_ns: int) -> None:
        """See `JobQueue`."""
        job = self._held(lease)
        self._jobs.replace(replace(job, state=OperationState.DONE.value, result=result, finished_at_ns=finished_at_ns))

    def fail(self, lease: Lease, code: str, message: str, now: Instant, finished_at_ns: int, *, retry: bool) -> bool:
        """See `JobQueue`."""
        job = self._held(lease)
        if retry and job.attempts < job.max_attempts:
            self._jobs.replace(_queued_again(job, now))
            return False
        self._jobs.replace(_failed(job, code, message, finished_at_ns))
        return True

    def fail_exhausted_jobs(self, now: Instant, finished_at_ns: int) -> list[JobRecord]:
        """See `JobQueue`."""
        dead = [_failed(job, ErrorCode.INTERNAL, _last_end(job), finished_at_ns) for job in self._jobs.exhausted(now)]
        for job in dead:
            self._jobs.replace(job)
        return dead

    def release(self, owner: str, now: Instant, reason: str) -> int:
        """See `JobQueue`."""
        held = self._jobs.leased_to(owner)
        for job in held:
            ended = replace(job, lease_expires_ms=0, failure_message=reason)
            # A job without attempts left stays RUNNING until `fail_exhausted_jobs`, which marks its subject too.
            self._jobs.replace(ended if job.attempts >= job.max_attempts else _queued_again(ended, now))
        return len(held)

    def _held(self, lease: Lease) -> JobRecord:
        """The stored job, if `lease` is still its newest. Raises StaleLease."""
        job = self._jobs.get(lease.job.tenant, lease.job.operation_id)
        if job is None or job.state != OperationState.RUNNING or job.lease_token != lease.job.lease_token:
            raise StaleLease(f"operation {lease.job.operation_id} is no longer leased to this run")
        return job


def _queued_again(job: JobRecord, now: Instant) -> JobRecord:
    """Back in the queue after a growing delay: a job that kills its workers lets other jobs run in between."""
    later = now.ms + RETRY_DELAY_MS * job.attempts
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
