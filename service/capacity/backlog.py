"""The backlog: jobs that wait in the queue, with a limit for each tenant; and posting a job to it."""

from __future__ import annotations

import hashlib
import json
import secrets
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from revisit.service.capacity.in_flight import InFlight
from revisit.service.capacity.limits import BACKLOG_RECOUNT_S, BACKLOG_RETRY_S
from revisit.service.domain.errors import WorkersBusy
from revisit.service.domain.identity import TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import JobRecord
from revisit.service.domain.states import OperationKind, OperationState
from revisit.service.ports.clock import Clock
from revisit.service.ports.storage import Storage
from revisit.service.ports.tracing import current_request
from revisit.service.ports.transactions import UnitOfWork


class Backlog:
    """How many jobs of each tenant wait, as last counted, and the limit."""

    def __init__(
        self, storage: Storage, in_flight: InFlight, most: int, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        """At most `most` jobs of a tenant wait; clouds in flight count as jobs to come. `now_s`: a monotonic clock."""
        self._storage = storage
        self._in_flight = in_flight
        self._most = most
        self._now_s = now_s
        self._waiting: dict[TenantId, int] = {}
        self._recounted_s: dict[TenantId, float] = {}

    async def precheck(self, tenant: TenantId) -> None:
        """Raises WorkersBusy where the backlog seems full, before any work is done. `require_space` decides."""
        if self._seems_full(tenant) and not self._recounted_lately(tenant):
            self._waiting[tenant] = await self._storage.read(lambda uow: _waiting(uow, tenant))
            self._recounted_s[tenant] = self._now_s()
        if self._seems_full(tenant):
            self._in_flight.note_overload(tenant)
            raise self._full()

    def require_space(self, uow: UnitOfWork, tenant: TenantId) -> None:
        """Raises WorkersBusy where the tenant's backlog is full; otherwise counts one job more. From any thread."""
        waiting = _waiting(uow, tenant)
        self._waiting[tenant] = min(waiting + 1, self._most)
        if waiting >= self._most:
            raise self._full()

    def _seems_full(self, tenant: TenantId) -> bool:
        return self._waiting.get(tenant, 0) + self._in_flight.clouds_of(tenant) >= self._most

    def _recounted_lately(self, tenant: TenantId) -> bool:
        recounted_s = self._recounted_s.get(tenant)
        return recounted_s is not None and self._now_s() < recounted_s + BACKLOG_RECOUNT_S

    def _full(self) -> WorkersBusy:
        message = f"{self._most} jobs are waiting; try again later with the same id"
        return WorkersBusy(message, retry_after_s=BACKLOG_RETRY_S)


def _waiting(uow: UnitOfWork, tenant: TenantId) -> int:
    return uow.jobs.count(tenant, state=OperationState.QUEUED.value)


QUERIES = (
    OperationKind.SEARCH_CLOUD, OperationKind.LOCALIZE, OperationKind.RELOCALISE, OperationKind.MAKE_TILE,
    OperationKind.MEASURE_MAP, OperationKind.MAKE_MESH, OperationKind.PREVIEW_ANCHORS,
)  # fmt: skip
"""The kinds of jobs for which a client waits."""

LAST = 2
"""The priority of jobs that all other work of the tenant goes before."""

_LAST = (OperationKind.FIND_CHANGES,)
"""Kinds of jobs that take long and are asked for again: what robots send goes before them, however many versions
somebody asks about."""


def same_job(
    uow: UnitOfWork,
    tenant: TenantId,
    kind: OperationKind,
    subject: str,
    payload: dict[str, Any],
    states: Sequence[OperationState] = (OperationState.QUEUED,),
) -> JobRecord | None:
    """A job that does the same and is in one of these states, the first of them first."""
    found = (uow.jobs.find(tenant, state=state.value, kind=kind.value, subject=subject) for state in states)
    return next((job for jobs in found for job in jobs if job.payload == payload), None)


UNENDED = (OperationState.QUEUED, OperationState.RUNNING)
"""The states of jobs that have not ended."""


def unended_jobs(uow: UnitOfWork, tenant: TenantId, kind: OperationKind) -> list[JobRecord]:
    """The jobs of a kind that wait, then those that run."""
    return [job for state in UNENDED for job in uow.jobs.find(tenant, state=state.value, kind=kind.value)]


_READ_WITHIN_NS = 60 * 10**9
"""An answer gives its place to that to the same question later: whoever waited for it has read it by then."""


def _question_id(job: JobRecord) -> str:
    """The id of a question by all that it asks."""
    asked = json.dumps([job.kind, job.subject, job.payload], sort_keys=True)
    return f"op-{hashlib.sha256(asked.encode()).hexdigest()[:20]}"


class JobPosting:
    """Adds jobs to the queue, within the limit of the backlog."""

    def __init__(self, backlog: Backlog, clock: Clock, policy: Policy) -> None:
        """`policy` says how many attempts a job has."""
        self._backlog = backlog
        self._clock = clock
        self._policy = policy

    def post(
        self, uow: UnitOfWork, tenant: TenantId, kind: OperationKind, subject: str, payload: dict[str, Any]
    ) -> JobRecord:
        """Queue a new job. Raises WorkersBusy."""
        return self.enqueue(uow, self.made(tenant, kind, subject, payload))

    def ask(
        self, uow: UnitOfWork, tenant: TenantId, kind: OperationKind, subject: str, payload: dict[str, Any]
    ) -> tuple[JobRecord, bool]:
        """Queue a question with a long payload, or join the same one that has not ended; whether it was joined.

        It is known by its id: the payloads of others that wait are not read. Raises WorkersBusy; AlreadyExists where
        another gateway has queued it at this moment.
        """
        job = self.made(tenant, kind, subject, payload)
        asked = replace(job, operation_id=_question_id(job))
        known = uow.jobs.get(tenant, asked.operation_id)
        if known is not None and not known.done:
            return known, True
        if known is not None and job.created_at_ns < (known.finished_at_ns or 0) + _READ_WITHIN_NS:
            return self.enqueue(uow, job), False
        uow.jobs.delete(tenant, operation_id=asked.operation_id)
        return self.enqueue(uow, asked), False

    def made(self, tenant: TenantId, kind: OperationKind, subject: str, payload: dict[str, Any]) -> JobRecord:
        """A job that is not queued yet. Those for which a client waits go before others, some after."""
        priority = 0 if kind in QUERIES else LAST if kind in _LAST else 1
        return queued_job(tenant, kind, subject, payload, self._policy, self._clock.wall_ns(), priority)

    def enqueue(self, uow: UnitOfWork, job: JobRecord) -> JobRecord:
        """Queue a job that was made. Raises WorkersBusy."""
        self._backlog.require_space(uow, TenantId(job.tenant))
        return uow.queue.enqueue(job)


def queued_job(
    tenant: TenantId,
    kind: OperationKind,
    subject: str,
    payload: dict[str, Any],
    policy: Policy,
    now_ns: int,
    priority: int = 1,
) -> JobRecord:
    """A new job with the request that asks for it; of lower `priority` is more urgent."""
    request = current_request()
    return JobRecord(
        tenant=tenant,
        operation_id=f"op-{secrets.token_hex(10)}",
        kind=kind.value,
        state=OperationState.QUEUED.value,
        subject=subject,
        payload=payload,
        attempts=0,
        max_attempts=policy.max_attempts,
        created_at_ns=now_ns,
        priority=priority,
        request_id=request.request_id,
        traceparent=request.span.traceparent,
    )
