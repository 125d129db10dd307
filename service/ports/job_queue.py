"""The job queue, its leases, and the workers that hold them. All times are of the store's own clock."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, Protocol

from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import JobRecord, TurnRecord, WorkerRecord

CANCELLED = {"outcome": "the operation was cancelled"}
"""The result of a job that somebody cancelled: it changed nothing."""


@dataclass(frozen=True)
class Lease:
    """The right to run a job until it runs out; `job.lease_id` is the fencing token."""

    job: JobRecord


class LeasedRuns(Protocol):
    """A worker's operations on one job: lease it, keep the lease, report its end."""

    def claim(self, owner: str) -> Lease | None:
        """Lease the next runnable job, of the next tenant in turn, to `owner`; the attempt is counted before.

        Raises DataLoss where it is damaged.
        """
        ...

    def require(self, lease: Lease) -> None:
        """Raises StaleLease where another worker holds the job by now."""
        ...

    def extend(self, lease: Lease) -> None:
        """Keep the lease. Raises StaleLease where another worker holds the job by now."""
        ...

    def complete(self, lease: Lease, result: dict[str, Any]) -> None:
        """End the job well. Raises StaleLease."""
        ...

    def fail(self, lease: Lease, code: str, message: str, *, retry: bool, innocent: bool = False) -> bool:
        """Count a failed run: back to the queue while `retry` and attempts are left. Whether it failed for good.

        `innocent`: the job had no part in it, so the run does not count against it, up to a bound.
        """
        ...


class LostRuns(Protocol):
    """Runs that ended with their worker."""

    def fail_exhausted_jobs(self) -> list[JobRecord]:
        """Fail and return the jobs with an expired lease and no attempts left."""
        ...

    def fail_damaged_jobs(self) -> list[JobRecord]:
        """Fail and return the unfinished jobs that cannot be read, for which `claim` raises DataLoss: without payload,
        and but for those that still cannot be read. Turns that cannot be read begin anew.
        """
        ...

    def release(self, owner: str, reason: str, *, innocent: bool = False) -> int:
        """End the runs of a worker that died of `reason`, without waiting for its leases to run out; how many.

        `innocent`: the job had no part in it, so the run does not count against it, up to a bound.
        """
        ...

    def forgive(self, family: str) -> int:
        """A gateway has started again: runs under way do not count against their jobs, up to a bound; how many.

        Those of workers of its `family`, by which their ids begin: they end with it. Their leases stay as they are.
        """
        ...


class ReportedRuns(Protocol):
    """How far a run has come."""

    def report(self, lease: Lease, progress: dict[str, Any]) -> bool:
        """Store `progress` (JSON). Whether to go on: False once somebody has asked to cancel. Raises StaleLease."""
        ...


class RunsInTurn(Protocol):
    """Runs that cannot end before others have ended."""

    def under_way(self, tenant: TenantId, operation_ids: Collection[str]) -> frozenset[str]:
        """Those of these operations that run on a lease that has not run out."""
        ...

    def put_back(self, lease: Lease, behind: Collection[str]) -> None:
        """End a run that waits for other operations of its tenant, `behind`: it was no attempt. Raises StaleLease.

        The job is due again in a moment, but no sooner than they.
        """
        ...


class JobQueue(LeasedRuns, LostRuns, ReportedRuns, RunsInTurn, Protocol):
    """Jobs in the same transaction as the rows they belong to; at least one run, at most one effect."""

    def enqueue(self, job: JobRecord, *, delay_ms: int = 0) -> JobRecord:
        """Queue a job, not to be run before `delay_ms` have passed."""
        ...

    def waits(self) -> bool:
        """Whether there is something to claim."""
        ...


@dataclass(frozen=True)
class Standing:
    """Who waits, and what the next job is counted from.

    `turns`: of the tenants with queued or running jobs. `latest_start_ms`: where the last job began that was claimed:
    nobody's time is counted from further back. `first_end_ms`: of the leases of running jobs the end that comes first.
    """

    turns: list[TurnRecord]
    latest_start_ms: int = 0
    first_end_ms: int | None = None


class TenantTurns(Protocol):
    """How much of the workers' time each tenant has had: a row for each of its workers, summed at reading."""

    def standing(self) -> Standing:
        """All that a claim asks of others' turns and leases, at one look."""
        ...

    def of_worker(self, worker_id: str) -> list[TurnRecord]:
        """What tenants have had of one worker."""
        ...

    def add(self, turn: TurnRecord, worker_id: str) -> None:
        """To a worker's row of a tenant: `ran_ms` is added, the later of the other times is kept."""
        ...

    def forget(self, worker_id: str) -> None:
        """Delete the rows of a worker."""
        ...

    def mend(self) -> None:
        """Begin anew for all tenants where a row is damaged: nothing but their order rests on it."""
        ...


class WorkerLog(Protocol):
    """Which worker processes live."""

    def beat(self, worker_id: str, model_version: str) -> None:
        """The worker shows itself."""
        ...

    def alive(self, within_ms: int) -> list[WorkerRecord]:
        """Workers seen within the last `within_ms` milliseconds, last seen first."""
        ...

    def silent(self, since_ms: int) -> list[str]:
        """The ids of workers that were not seen for the last `since_ms` milliseconds, and not forgotten."""
        ...

    def forget(self, worker_id: str) -> None:
        """The worker is gone."""
        ...
