"""Runs leased jobs by their kind and commits how they end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import structlog

from revisit.core.errors import ErrorCode, MissingLibrary, RevisitError
from revisit.service.domain.errors import ExtraMissing, OutOfTurn, StaleLease, StorageFull, Unavailable
from revisit.service.domain.states import OperationKind
from revisit.service.failpoints import failpoint
from revisit.service.features.operations.dead_letters import mark_subject_failed
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.tracing import current_request
from revisit.service.ports.transactions import UnitOfWork

log = structlog.get_logger(__name__)

Jobs = Mapping[OperationKind, Callable[[Lease], None]]
"""The job of each kind: it commits its own good end."""


class JobRunner:
    """Runs leased jobs in a worker process; all calls block."""

    def __init__(self, context: JobContext, jobs: Jobs) -> None:
        """`jobs` has every kind."""
        self._context = context
        self._jobs = jobs

    def run(self, lease: Lease) -> None:
        """Run a job and commit its end, good or bad. Raises only storage errors of that commit."""
        try:
            failpoint("job.after_claim")
            self._jobs[OperationKind(lease.job.kind)](lease)
            failpoint("job.after_commit")
        except StaleLease:
            log.warning("result_refused", operation=lease.job.operation_id, lease=lease.job.lease_id)
        except OutOfTurn as error:
            self._put_back(lease, error)
        except RevisitError as error:
            # A store that is full, or does not answer, says nothing about the job.
            of_storage = isinstance(error, Unavailable | StorageFull)
            self._fail(lease, error.code, error.message, retry=of_storage, innocent=of_storage)
        except MissingLibrary as error:  # a second run of this worker would miss it, too
            self._fail(lease, ExtraMissing.code, str(error), retry=False)
        except MemoryError:
            self.fail(lease, "the job needs more memory than a worker may take")
        except Exception as error:  # no error of the method may end the worker
            log.exception("job_crashed", operation=lease.job.operation_id)
            self.fail(lease, f"{type(error).__name__}: {error}"[:500])

    def _put_back(self, lease: Lease, error: OutOfTurn) -> None:
        log.info("job_put_back", operation=lease.job.operation_id, reason=error.reason)
        self._end(lease, lambda uow: uow.queue.put_back(lease, error.operation_ids))

    def fail(self, lease: Lease, message: str) -> None:
        """End this run of a job: back to the queue, or failed for good after its last attempt."""
        self._fail(lease, ErrorCode.INTERNAL, message, retry=True)

    def _fail(self, lease: Lease, code: ErrorCode, message: str, *, retry: bool, innocent: bool = False) -> None:
        end = partial(self._store_failure, lease=lease, code=code, message=message, retry=retry, innocent=innocent)
        failpoint("job.before_failure")
        current_request().span.fail(f"{code}: {message}")
        log.warning("job_failed", operation=lease.job.operation_id, code=code, reason=message, retry=retry)
        self._end(lease, end)

    def _end(self, lease: Lease, end: Callable[[UnitOfWork], None]) -> None:
        try:
            self._context.transactions.write(end).result()
        except StaleLease:
            log.warning("end_refused", operation=lease.job.operation_id, lease=lease.job.lease_id)

    def _store_failure(
        self, uow: UnitOfWork, lease: Lease, code: ErrorCode, message: str, *, retry: bool, innocent: bool
    ) -> None:
        if uow.queue.fail(lease, code, message, retry=retry, innocent=innocent):
            mark_subject_failed(uow, lease.job, code, message)
