"""The job queue: leases, attempts and fencing tokens over the jobs of any store.

A worker leases a job and extends the lease by heartbeats. When a lease runs out, by the clock of the store, the next
worker takes the job with a lease of its own, and later reports of the first one are refused. A job without attempts
left is a dead letter.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any, Protocol

from revisit.core.errors import DataLoss, ErrorCode
from revisit.service.domain.errors import StaleLease
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import JobRecord, TurnRecord
from revisit.service.domain.states import OperationState
from revisit.service.engines.fair_turns import FairTurns
from revisit.service.ports.clock import Clock
from revisit.service.ports.job_queue import Lease, Standing
from revisit.service.ports.repositories import JobRepository

RETRY_DELAY_MS = 500

MOST_FORGIVEN = 20
"""Runs of a job that may end for a reason that seems none of its own. A job that ends its worker in such a way every
time is poison all the same: from then on its runs count."""

DAMAGED = "the stored job is damaged: post its subject again, or ask again"
"""Why a job ends that cannot be read."""

STARTED_AGAIN = "the service was ended"
"""Why a run did not come back that was under way then."""


class LeasableJobs(JobRepository, Protocol):
    """Jobs with their leases, across tenants. Those to `hold` are nobody else's to change before the transaction ends;
    such as another transaction holds are passed over.
    """

    def next_runnable(
        self, now_ms: int, tenant: TenantId, *, lost: bool = True, hold: bool = False
    ) -> JobRecord | None:
        """A job that is queued and due, or has an expired lease and attempts left: the most urgent, then oldest.

        Where it is not asked for the `lost`, only among the queued.
        """
        ...

    def exhausted(self, now_ms: int, *, hold: bool = False) -> list[JobRecord]:
        """Jobs running on a lease that has run out, with no attempts left, but for damaged ones."""
        ...

    def leased_to(self, owner: str | None) -> list[JobRecord]:
        """The running jobs of a worker, or of all, which are held, but for damaged ones."""
        ...

    def fail_damaged(self, code: str, message: str, finished_at_ns: int) -> list[JobRecord]:
        """End all unfinished jobs whose rows cannot be read as FAILED; those that can be read now, without payload."""
        ...

    def exchange(self, before: JobRecord, after: JobRecord) -> None:
        """As `replace`, of a job that this transaction holds."""
        ...


class LeasedJobs:
    """`JobQueue` over `LeasableJobs`, inside their transaction."""

    def __init__(
        self,
        jobs: LeasableJobs,
        turns: FairTurns,
        lease_ms: int,
        now_ms: Callable[[], int],
        clock: Clock,
    ) -> None:
        """A lease lasts `lease_ms` milliseconds from its start or its last heartbeat; `turns` orders the tenants.

        `now_ms` is the time of the store, which decides; that of `clock` is a label.
        """
        self._jobs = jobs
        self._turns = turns
        self._lease_ms = lease_ms
        self._now_ms = now_ms
        self._clock = clock
        self._seen: Standing | None = None

    def enqueue(self, job: JobRecord, *, delay_ms: int = 0) -> JobRecord:
        """See `JobQueue`."""
        self._seen = None
        if delay_ms:
            now_ms = self._now_ms()
            job = replace(job, claimed_ms=now_ms, not_before_ms=now_ms + delay_ms)
        return self._jobs.add(job)

    def under_way(self, tenant: TenantId, operation_ids: Collection[str]) -> frozenset[str]:
        """See `JobQueue`."""
        now_ms = self._now_ms()
        running = (job for job in self._found(tenant, operation_ids) if job.state == OperationState.RUNNING)
        return frozenset(job.operation_id for job in running if job.lease_expires_ms > now_ms)

    def waits(self) -> bool:
        """See `JobQueue`."""
        now_ms = self._now_ms()
        try:
            standing = self._turns.standing()
            lost = _any_lost(standing, now_ms)
            return self._next(now_ms, standing) is not None or (lost and bool(self._jobs.exhausted(now_ms)))
        except DataLoss:
            return True

    def claim(self, owner: str) -> Lease | None:
        """See `JobQueue`."""
        now_ms = self._now_ms()
        standing, self._seen = self._seen or self._turns.standing(), None
        found = self._next(now_ms, standing, hold=True)
        if found is None:
            return None
        turn, job = found
        if job.state == OperationState.RUNNING:
            self._turns.end(job.tenant, job.lease_owner, job.lease_expires_ms - job.claimed_ms)
        leased = replace(
            job,
            state=OperationState.RUNNING.value,
            attempts=job.attempts + 1,
            lease_owner=owner,
            lease_id=secrets.token_hex(16),
            lease_expires_ms=now_ms + self._lease_ms,
            claimed_ms=now_ms,
            failure_message=None,
        )
        self._turns.begin(turn, owner)
        self._jobs.exchange(job, leased)
        return Lease(leased)

    def require(self, lease: Lease) -> None:
        """See `JobQueue`."""
        self._held(lease)

    def extend(self, lease: Lease) -> None:
        """See `JobQueue`."""
        job = self._held(lease)
        self._jobs.exchange(job, replace(job, lease_expires_ms=self._now_ms() + self._lease_ms))

    def report(self, lease: Lease, progress: dict[str, Any]) -> bool:
        """See `JobQueue`."""
        job = self._held(lease)
        self._jobs.exchange(job, replace(job, progress=progress))
        return not job.cancel_requested

    def complete(self, lease: Lease, result: dict[str, Any]) -> None:
        """See `JobQueue`."""
        job = self._held(lease)
        self._turns.end(job.tenant, job.lease_owner, self._now_ms() - job.claimed_ms)
        done, ended_ns = OperationState.DONE.value, self._clock.wall_ns()
        self._jobs.exchange(job, replace(job, state=done, result=result, failure_message=None, finished_at_ns=ended_ns))

    def put_back(self, lease: Lease, behind: Collection[str]) -> None:
        """See `JobQueue`."""
        held, now_ms = self._held(lease), self._now_ms()
        self._turns.end(held.tenant, held.lease_owner, now_ms - held.claimed_ms)
        due_ms = max(job.not_before_ms for job in (held, *self._found(held.tenant, behind)))
        due_ms = max(due_ms, now_ms + RETRY_DELAY_MS)
        self._jobs.exchange(held, _queued(replace(held, attempts=held.attempts - 1), due_ms))

    def fail(self, lease: Lease, code: str, message: str, *, retry: bool, innocent: bool = False) -> bool:
        """See `JobQueue`."""
        held, now_ms = self._held(lease), self._now_ms()
        job = _forgiven(held) if innocent else held
        self._turns.end(job.tenant, job.lease_owner, now_ms - job.claimed_ms)
        if retry and job.counted_attempts < job.max_attempts:
            self._jobs.exchange(held, _queued_again(job, now_ms))
            return False
        self._jobs.exchange(held, _failed(job, code, message, self._clock.wall_ns()))
        return True

    def fail_exhausted_jobs(self) -> list[JobRecord]:
        """See `JobQueue`. Where no lease is lost, a claim that follows need not look again."""
        now_ms, standing = self._now_ms(), self._turns.standing()
        if not _any_lost(standing, now_ms):
            self._seen = standing
            return []
        buried, ended_ns = [], self._clock.wall_ns()
        for job in self._jobs.exhausted(now_ms, hold=True):
            # The runs of a worker that was released were paid for then.
            if job.lease_expires_ms:
                self._turns.end(job.tenant, job.lease_owner, job.lease_expires_ms - job.claimed_ms)
            buried.append(_failed(job, ErrorCode.INTERNAL, _last_end(job), ended_ns))
            self._jobs.exchange(job, buried[-1])
        return buried

    def fail_damaged_jobs(self) -> list[JobRecord]:
        """See `JobQueue`."""
        self._turns.mend()
        return self._jobs.fail_damaged(ErrorCode.DATA_LOSS, DAMAGED, self._clock.wall_ns())

    def release(self, owner: str, reason: str, *, innocent: bool = False) -> int:
        """See `JobQueue`."""
        held, now_ms = self._jobs.leased_to(owner), self._now_ms()
        for job in held:
            self._turns.end(job.tenant, owner, now_ms - job.claimed_ms)
            # One that the service forgave at its start is not forgiven twice.
            forgiven = innocent and job.failure_message is None
            ended = replace(_forgiven(job) if forgiven else job, failure_message=reason)
            # A job without attempts left stays RUNNING until `fail_exhausted_jobs`, which marks its subject too.
            spent = ended.counted_attempts >= ended.max_attempts
            again = ended if spent else _queued_again(ended, now_ms)
            self._jobs.exchange(job, replace(again, lease_expires_ms=0))
        self._turns.forget(owner)
        return len(held)

    def forgive(self, family: str) -> int:
        """See `JobQueue`."""
        running = [job for job in self._jobs.leased_to(None) if (job.lease_owner or "").startswith(family)]
        # A reason is there where the run was forgiven before, or was the last of a job that is to be buried.
        under_way = [job for job in running if job.failure_message is None]
        for job in under_way:
            self._jobs.exchange(job, replace(_forgiven(job), failure_message=STARTED_AGAIN))
        return len(under_way)

    def _next(self, now_ms: int, standing: Standing, *, hold: bool = False) -> tuple[TurnRecord, JobRecord] | None:
        """The job that is to run next: the first of the first tenant, in the order of their turns, that has one."""
        lost = _any_lost(standing, now_ms)
        for turn in self._turns.order(standing):
            job = self._jobs.next_runnable(now_ms, turn.tenant, lost=lost, hold=hold)
            if job is not None:
                return turn, job
        return None

    def _found(self, tenant: TenantId, operation_ids: Collection[str]) -> list[JobRecord]:
        jobs = (self._jobs.get(tenant, operation_id) for operation_id in operation_ids)
        return [job for job in jobs if job is not None]

    def _held(self, lease: Lease) -> JobRecord:
        """The stored job, if `lease` is still its newest. Raises StaleLease."""
        job = self._jobs.get(lease.job.tenant, lease.job.operation_id, hold=True)
        if job is None or job.state != OperationState.RUNNING or job.lease_id != lease.job.lease_id:
            raise StaleLease(f"operation {lease.job.operation_id} is no longer leased to this run")
        return job


def _any_lost(standing: Standing, now_ms: int) -> bool:
    """Whether the lease of some running job has run out."""
    return standing.first_end_ms is not None and standing.first_end_ms <= now_ms


def _forgiven(job: JobRecord) -> JobRecord:
    """The run under way does not count against the job, unless too many have not already."""
    return job if job.forgiven >= MOST_FORGIVEN else replace(job, forgiven=job.forgiven + 1)


def _queued_again(job: JobRecord, now_ms: int) -> JobRecord:
    """Back in the queue after a pause: a job that kills its workers, or takes long in vain, lets others run in between.

    The pause grows with the attempts and is no shorter than the run was.
    """
    return _queued(job, now_ms + max(RETRY_DELAY_MS * job.attempts, now_ms - job.claimed_ms))


def _queued(job: JobRecord, due_ms: int) -> JobRecord:
    return replace(job, state=OperationState.QUEUED.value, not_before_ms=due_ms)


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
