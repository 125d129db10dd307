"""Progress of a run, shown by its operation; and its cancellation."""

from __future__ import annotations

from functools import partial
from typing import Any

from revisit.service.capacity.backlog import unended_jobs
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import JobRecord
from revisit.service.domain.states import OperationKind
from revisit.service.ports.blobs import MERGE_PORTION_BLOB, Blob, StoredBlob
from revisit.service.ports.clock import Clock
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.transactions import Transactions, UnitOfWork

REPORT_EVERY_MS = 500
"""Each report is a write that other writers wait for."""

_PORTION = "portion"
"""Member of a report: the hash of the blob from which the next run of the job goes on."""


class OperationCancelled(Exception):  # an end that was asked for is no error
    """Somebody has asked the run to end."""


class Progress:
    """Reports of one run, stored at each new stage and now and then within it."""

    def __init__(self, transactions: Transactions, clock: Clock, lease: Lease) -> None:
        """`lease` is that of the run."""
        self._transactions = transactions
        self._clock = clock
        self._lease = lease
        self._report: dict[str, Any] = {"stage": ""}
        self._reported_ms = 0
        kept = portion_of(lease.job)
        self._portion = {} if kept is None else {_PORTION: kept.sha256}

    def __call__(self, stage: str, done: int = 0, total: int = 1) -> None:
        """`done` of `total` parts of a stage. Raises OperationCancelled, StaleLease."""
        now_ms = self._clock.monotonic_ms()
        if stage == self._report["stage"] and now_ms < self._reported_ms + REPORT_EVERY_MS:
            return
        self._report, self._reported_ms = {"stage": stage, "done": done, "total": total}, now_ms
        self._tell(durable=False)

    def name_portion(self, sha256: str) -> None:
        """Name the blob from which the next run goes on, in this report and those that follow. Raises as a report."""
        self._portion = {_PORTION: sha256}
        self._tell(durable=True)

    def _tell(self, *, durable: bool) -> None:
        report = {**self._report, **self._portion}
        if not self._transactions.write(partial(_report, lease=self._lease, report=report), durable=durable).result():
            raise OperationCancelled


def portion_of(job: JobRecord) -> StoredBlob | None:
    """What a run of the job has kept for the next one."""
    sha256 = (job.progress or {}).get(_PORTION)
    return None if sha256 is None else StoredBlob(job.tenant, MERGE_PORTION_BLOB, str(sha256))


def kept_for_jobs(uow: UnitOfWork, tenant: TenantId) -> set[Blob]:
    """The blobs that the jobs of a tenant go on with which have not ended, however long these wait."""
    kept = map(portion_of, unended_jobs(uow, tenant, OperationKind.MERGE_MAP))
    return {(blob.kind, blob.sha256) for blob in kept if blob is not None}


def shown(job: JobRecord) -> dict[str, Any] | None:
    """The progress of a job for its clients."""
    return None if job.progress is None else {name: one for name, one in job.progress.items() if name != _PORTION}


def _report(uow: UnitOfWork, lease: Lease, report: dict[str, Any]) -> bool:
    return uow.queue.report(lease, report)
