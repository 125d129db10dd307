"""The service's own errors, beside those of the core: the same codes, the same base class."""

from __future__ import annotations

from collections.abc import Collection

from revisit.core.errors import ErrorCode, RevisitError


class NotFound(RevisitError):
    """There is no such resource (or it belongs to another tenant)."""

    code = ErrorCode.NOT_FOUND


class NotKept(NotFound):
    """The policy of retention of the map has removed what was asked for."""


class AlreadyExists(RevisitError):
    """The id is taken by a resource with other content."""

    code = ErrorCode.ALREADY_EXISTS


class SessionFinished(RevisitError):
    """The session is finished and takes no more scans or submaps."""

    code = ErrorCode.SESSION_FINISHED


class SequenceGap(RevisitError):
    """The scan does not follow the last committed one."""

    code = ErrorCode.SEQ_GAP

    def __init__(self, expected: int, got: int) -> None:
        """`expected` is the sequence number the session can take next."""
        super().__init__(f"expected seq {expected}, got {got}", field="seq")
        self.expected = expected


class StreamFenced(RevisitError):
    """A newer stream of the same session took over."""

    code = ErrorCode.STREAM_FENCED


class NotReady(RevisitError):
    """The submap is not described yet: wait for its operation."""

    code = ErrorCode.NOT_READY


class DeadlineExceeded(RevisitError):
    """The answer took longer than the time allowed for it."""

    code = ErrorCode.DEADLINE_EXCEEDED


class SeqNotReached(RevisitError):
    """Submaps up to `min_seq` are not described yet, after the time allowed for waiting."""

    code = ErrorCode.SEQ_NOT_REACHED


class NoAnswer(RevisitError):
    """No worker has answered a query by cloud in time; the query was dropped, since nobody waits for it any more."""

    code = ErrorCode.NO_ANSWER


class Unavailable(RevisitError):
    """The service cannot do this now: try again after `retry_after_s`."""

    code = ErrorCode.WORKERS_BUSY

    def __init__(self, message: str | None = None, *, retry_after_s: float = 1.0, reason: str = "") -> None:
        """`retry_after_s` is a hint for the client, seconds; `reason` as in `RevisitError`."""
        super().__init__(message, reason=reason)
        self.retry_after_s = retry_after_s


class OutOfTurn(Unavailable):
    """A job lets others run first: it has done a portion of its work, or cannot end before these operations, of its own
    tenant, have ended, and not all of them are under way.
    """

    def __init__(self, message: str, operation_ids: Collection[str]) -> None:
        """The job is to run again once `operation_ids` may have begun."""
        super().__init__(message)
        self.operation_ids = operation_ids


class WorkersBusy(Unavailable):
    """Too many jobs are waiting: try again later with the same id."""

    code = ErrorCode.WORKERS_BUSY


class BlobCollected(Unavailable):
    """The same content is being deleted at this moment: nothing was stored. Try again."""

    code = ErrorCode.WORKERS_BUSY

    def __init__(self, gone: frozenset[int], *, pending: bool) -> None:
        """`gone` numbers the collections that have deleted a blob; `pending`: another one has yet to."""
        super().__init__()
        self.gone = gone
        self.pending = pending


class StillDeleting(Unavailable):
    """The former resource of this id is being deleted: the id is free again soon. Try again with the same id."""

    code = ErrorCode.WORKERS_BUSY


class RateLimited(Unavailable):
    """More comes from this client, or for its tenant, than its quota: try again later with the same id."""

    code = ErrorCode.RATE


class QuotaReached(Unavailable):
    """The tenant has stored as much as it may: nothing was stored. Delete something, then send it again."""

    code = ErrorCode.QUOTA


class Draining(Unavailable):
    """The service is shutting down: try again with the same id."""

    code = ErrorCode.DRAINING


class StorageUncertain(Unavailable):
    """The store failed while committing: the change may or may not be stored, so repeat it with the same id."""

    code = ErrorCode.STORAGE_UNCERTAIN


class StorageFull(RevisitError):
    """The disk is full: nothing was stored."""

    code = ErrorCode.STORAGE_FULL


class Unauthenticated(RevisitError):
    """The credential is missing or not valid."""

    code = ErrorCode.UNAUTHENTICATED


class RevokedKey(Unauthenticated):
    """The key was revoked or has expired."""


class PermissionDenied(RevisitError):
    """The credential does not reach so far."""

    code = ErrorCode.PERMISSION_DENIED


class TooManyFailures(Unavailable):
    """Too many failed attempts to authenticate: check the credential before you try again."""

    code = ErrorCode.RATE


class ExtraMissing(RevisitError):
    """The worker was installed without the extra that this takes."""

    code = ErrorCode.EXTRA_MISSING


class StaleLease(RevisitError):
    """Another worker holds this job by now: the result is refused."""

    code = ErrorCode.INTERNAL


def error_of(code: str, message: str) -> RevisitError:
    """The stored error of a worker, to be raised again for the waiting client."""
    error = RevisitError(message)
    error.code = ErrorCode(code)
    return error
