"""Dead letters: operations that have failed for good. They are kept with their reason until somebody queues them again.

There is no second list beside the operations: `Operations.list` with the state FAILED is the list of dead letters, an
operation's `failure` the reason, and here is the way back.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import structlog

from revisit.core.errors import BadField, DataLoss
from revisit.service.capacity.backlog import QUERIES, Backlog
from revisit.service.domain.errors import NotFound
from revisit.service.domain.identity import SubmapKey, TenantId
from revisit.service.domain.records import JobRecord, SubmapRecord
from revisit.service.domain.states import OperationKind, OperationState, SubmapState
from revisit.service.features.loops.waiting import accept_decided
from revisit.service.features.resources.call_context import CallContext
from revisit.service.ports.storage import require_job, require_map
from revisit.service.ports.transactions import UnitOfWork

log = structlog.get_logger(__name__)


class DeadLetters:
    """Queue failed operations again."""

    def __init__(self, context: CallContext, backlog: Backlog) -> None:
        """The policy says how many attempts a job has."""
        self._context = context
        self._backlog = backlog

    async def retry(self, tenant: TenantId, operation_id: str) -> JobRecord:
        """Queue failed work again, with as many attempts as new work; other work is left alone.

        Raises NotFound, also where its submap was deleted; BadField for a search: its cloud is not kept;
        WorkersBusy, Draining.
        """
        self._context.admission.require_running()
        return await self._context.storage.write(partial(self._retry, tenant=tenant, operation_id=operation_id))

    def _retry(self, uow: UnitOfWork, tenant: TenantId, operation_id: str) -> JobRecord:
        job = require_job(uow, tenant, operation_id, hold=True)
        if job.state != OperationState.FAILED:
            return job
        if job.kind in QUERIES:
            raise BadField("the cloud of a search is not kept: ask again instead", field="name")
        submap = _subject(uow, job) if job.kind == OperationKind.DESCRIBE_SUBMAP else None
        if submap is None and job.kind == OperationKind.DESCRIBE_SUBMAP:
            raise NotFound(f"the submap of operation {operation_id} was deleted")
        self._backlog.require_space(uow, tenant)
        queued = replace(
            job,
            state=OperationState.QUEUED.value,
            max_attempts=job.counted_attempts + self._context.policy.max_attempts,
            not_before_ms=0,
            failure_code=None,
            failure_message=None,
            finished_at_ns=None,
            cancel_requested=False,
        )
        uow.jobs.replace(queued)
        if submap is not None:
            queued_again = replace(submap, state=SubmapState.QUEUED.value, failure_code=None, failure_message=None)
            uow.submaps.replace(queued_again)
        return queued


def mark_subject_failed(uow: UnitOfWork, job: JobRecord, code: str, message: str) -> None:
    """Mark the submap as failed: its description has failed for good. It leaves its map, if it has entered it.

    A submap whose row is damaged stays as it is: the job ends all the same.
    """
    try:
        submap = _subject(uow, job) if job.kind == OperationKind.DESCRIBE_SUBMAP else None
    except DataLoss as error:
        log.error("subject_damaged", operation=job.operation_id, subject=job.subject, reason=error.reason)
        return
    if submap is None:
        return
    if submap.state == SubmapState.DESCRIBED:
        record = require_map(uow, submap.tenant, submap.map_id)
        uow.changes.record_removed(record, [submap.number])
    failed = replace(submap, state=SubmapState.FAILED.value, failure_code=code, failure_message=message)
    uow.submaps.replace(replace(failed, descriptor=None, entered=0, searched=True))
    ended = uow.jobs.get(job.tenant, job.operation_id)
    accept_decided(uow, job.tenant, submap.key.session, (ended or job).finished_at_ns or 0)


def _subject(uow: UnitOfWork, job: JobRecord) -> SubmapRecord | None:
    """The submap that a job describes, unless it was deleted (and maybe posted again, with a job of its own)."""
    if not job.payload:  # the row of the job was damaged
        return next(iter(uow.submaps.find(job.tenant, operation_id=job.operation_id)), None)
    key = SubmapKey(**job.payload)
    submap = uow.submaps.get(job.tenant, key.map_id, key.session_id, key.submap_id, hold=True)
    return submap if submap is not None and submap.operation_id == job.operation_id else None
