"""The job queue, its leases, and the workers that hold them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from revisit.service.application.contract.clock import Instant
from revisit.service.application.contract.records import JobRecord, WorkerRecord


@dataclass(frozen=True)
class Lease:
    """The right to run a job until it runs out; `job.lease_token` is the fencing token."""

    job: JobRecord


class LeasedRuns(Protocol):
    """What a worker does with one job: lease it, keep the lease, report its end."""

    def claim(self, owner: str, now: Instant, after: str = "") -> Lease | None:
        """Lease the next runnable job behind tenant `after` to `owner`; the attempt is counted before the run."""
        ...

    def require(self, lease: Lease) -> None:
        """Raises StaleLease where another worker holds the job by now."""
        ...

    def extend(self, lease: Lease, now: Instant) -> None:
        """Keep the lease. Raises StaleLease where another worker holds the job by now."""
        ...

    def complete(self, lease: Lease, result: dict[str, Any], finished_at_ns: int) -> None:
        """End the job well. Raises StaleLease."""
        ...

    def fail(self, lease: Lease, code: str, message: str, now: Instant, finished_at_ns: int, *, retry: bool) -> bool:
        """Count a failed run: back to the queue while `retry` and attempts are left. Whether it failed for good."""
        ...


class LostRuns(Protocol):
    """Runs that ended with their worker."""

    def fail_exhausted_jobs(self, now: Instant, finished_at_ns: int) -> list[JobRecord]:
        """Fail the jobs whose lease has run out with no attempts left; returns them."""
        ...

    def release(self, owner: str, now: Instant, reason: str) -> int:
        """End the runs of a worker that died of `reason`, without waiting for its leases to run out; how many."""
        ...


class JobQueue(LeasedRuns, LostRuns, Protocol):
    """Jobs in the same transaction as the rows they belong to; at least one run, at most one effect."""

    def enqueue(self, job: JobRecord) -> JobRecord:
        """Queue a job."""
        ...


class WorkerLog(Protocol):
    """Which worker processes live."""

    def beat(self, worker: WorkerRecord) -> None:
        """The worker shows itself."""
        ...

    def alive(self, epoch: str, since_ms: int) -> list[WorkerRecord]:
        """Workers seen at or after `since_ms` of `epoch`, last seen first."""
        ...

    def forget(self, worker_id: str) -> None:
        """The worker is gone."""
        ...
