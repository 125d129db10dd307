"""Claiming the next job for a worker."""

from __future__ import annotations

from revisit.core.errors import DataLoss, ErrorCode
from revisit.service.features.operations.dead_letters import mark_subject_failed
from revisit.service.ports.blobs import BlobOutage
from revisit.service.ports.disk import DiskSpace
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.transactions import Transactions, UnitOfWork


class JobClaims:
    """Claims jobs for one worker; tenants take turns."""

    def __init__(self, transactions: Transactions, disk: DiskSpace, blobs: BlobOutage, owner: str) -> None:
        """`owner` is the id of the worker."""
        self._transactions = transactions
        self._disk = disk
        self._blobs = blobs
        self._owner = owner

    def next(self) -> Lease | None:
        """The lease of the next job; None where no job waits, or its result could not be stored.

        Reads before it writes where a write holds up all other writers: where the store tells of commits. A job whose
        row is damaged fails, so that it stands in nobody's way. Raises Unavailable, DataLoss.
        """
        if self._disk.exhausted() or self._blobs.unreachable():
            return None
        alone = self._transactions.version() is not None
        try:
            if alone and not self._transactions.read(lambda uow: uow.queue.waits()).result():
                return None
            return self._transactions.write(self._claim, durable=False).result()
        except DataLoss:
            self._transactions.write(_fail_damaged).result()
            return self._transactions.write(self._claim, durable=False).result()

    def _claim(self, uow: UnitOfWork) -> Lease | None:
        for job in uow.queue.fail_exhausted_jobs():
            mark_subject_failed(uow, job, ErrorCode.INTERNAL, job.failure_message or "")
        return uow.queue.claim(self._owner)


def _fail_damaged(uow: UnitOfWork) -> None:
    for job in uow.queue.fail_damaged_jobs():
        mark_subject_failed(uow, job, ErrorCode.DATA_LOSS, job.failure_message or "")
