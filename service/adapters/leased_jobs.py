"""The job queue: leases, attempts and fencing over the stored jobs of either store."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from core.errors import ErrorCode
from service.application.errors import StaleLease
from service.application.ports import Instant, JobRepository, Lease
from service.application.records import JobRecord

RETRY_DELAY_MS = 500


class LeasedJobs:
    """`ports.JobQueue` over a `JobRepository`, inside whatever transaction that belongs to."""

    def __init__(self, jobs: JobRepository, lease_ms: int) -> None:
        """A lease runs out `lease_ms` after the last heartbeat."""
        self._jobs = jobs
        self._lease_ms = lease_ms

    def enqueue(self, job: JobRecord) -> JobRecord:
        """See `ports.JobQueue`."""
        return self._jobs.add(job)

    def claim(self, owner: str, now: Instant) -> Lease | None:
        """See `ports.JobQueue`."""
        job = self._jobs.next_runnable(now)
        if job is None:
            return None
        leased = replace(
            job,
            state="RUNNING",
            attempts=job.attempts + 1,
            lease_owner=owner,
            lease_token=job.lease_token + 1,
            lease_epoch=now.epoch,
            lease_expires_ms=now.ms + self._lease_ms,
        )
        self._jobs.replace(leased)
        return Lease(leased)

    def extend(self, lease: Lease, now: Instant) -> None:
        """See `ports.JobQueue`."""
        job = self._held(lease)
        self._jobs.replace(replace(job, lease_epoch=now.epoch, lease_expires_ms=now.ms + self._lease_ms))

    def complete(self, lease: Lease, result: dict[str, Any], finished_at_ns: int) -> None:
        """See `ports.JobQueue`."""
        job = self._held(lease)
        self._jobs.replace(replace(job, state="DONE", result=result, finished_at_ns=finished_at_ns))

    def fail(self, lease: Lease, code: str, message: str, now: Instant, finished_at_ns: int, *, retry: bool) -> bool:
        """See `ports.JobQueue`."""
        job = self._held(lease)
        if retry and job.attempts < job.max_attempts:
            later = now.ms + RETRY_DELAY_MS * job.attempts
            self._jobs.replace(replace(job, state="QUEUED", lease_epoch=now.epoch, not_before_ms=later))
            return False
        self._jobs.replace(_failed(job, code, message, finished_at_ns))
        return True

    def bury(self, now: Instant, finished_at_ns: int) -> list[JobRecord]:
        """See `ports.JobQueue`."""
        message = "the worker ended during every attempt"
        dead = [_failed(job, ErrorCode.INTERNAL, message, finished_at_ns) for job in self._jobs.exhausted(now)]
        for job in dead:
            self._jobs.replace(job)
        return dead

    def release(self, owner: str) -> int:
        """See `ports.JobQueue`."""
        held = self._jobs.leased_to(owner)
        for job in held:
            self._jobs.replace(replace(job, lease_expires_ms=0))
        return len(held)

    def _held(self, lease: Lease) -> JobRecord:
        """The job as stored, if `lease` still is its newest. Raises StaleLease."""
        job = self._jobs.get(lease.job.tenant, lease.job.operation_id)
        if job is None or job.state != "RUNNING" or job.lease_token != lease.job.lease_token:
            raise StaleLease(f"operation {lease.job.operation_id} is no longer leased to this run")
        return job


def _failed(job: JobRecord, code: str, message: str, finished_at_ns: int) -> JobRecord:
    return replace(job, state="FAILED", failure_code=code, failure_message=message, finished_at_ns=finished_at_ns)
