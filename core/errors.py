"""Errors of the core: transport-free codes and the exceptions that carry them.

An exception's docstring is its default message; `service/status.py` maps every code to HTTP and gRPC.
"No loop" and "rejected by verification" are results, never errors.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping

from revisit.core.string_enum import StrEnum


class ErrorCode(StrEnum):
    """Every reason the product gives for refusing something."""

    MALFORMED_BODY = "MALFORMED_BODY"
    UNUSABLE_CLOUD = "UNUSABLE_CLOUD"
    BAD_FIELD = "BAD_FIELD"
    UNSUPPORTED_ENCODING = "UNSUPPORTED_ENCODING"
    TOO_LARGE = "TOO_LARGE"
    NOT_FOUND = "NOT_FOUND"
    METHOD_NOT_ALLOWED = "METHOD_NOT_ALLOWED"
    ALREADY_EXISTS = "ALREADY_EXISTS"
    SESSION_FINISHED = "SESSION_FINISHED"
    DESCRIPTOR_MODEL_MISMATCH = "DESCRIPTOR_MODEL_MISMATCH"
    NOT_READY = "NOT_READY"
    SEQ_GAP = "SEQ_GAP"
    STREAM_FENCED = "STREAM_FENCED"
    RATE = "RATE"
    QUOTA = "QUOTA"
    WORKERS_BUSY = "WORKERS_BUSY"
    DRAINING = "DRAINING"
    STORAGE_UNCERTAIN = "STORAGE_UNCERTAIN"
    STORAGE_FULL = "STORAGE_FULL"
    DEADLINE_EXCEEDED = "DEADLINE_EXCEEDED"
    SEQ_NOT_REACHED = "SEQ_NOT_REACHED"
    NO_ANSWER = "NO_ANSWER"
    UNAUTHENTICATED = "UNAUTHENTICATED"
    PERMISSION_DENIED = "PERMISSION_DENIED"
    EXTRA_MISSING = "EXTRA_MISSING"
    DATA_LOSS = "DATA_LOSS"
    INTERNAL = "INTERNAL"

    @classmethod
    def _missing_(cls, value: object) -> ErrorCode | None:
        """The code that a former one belongs to: stored failures keep the name that they were written with."""
        return cls[FORMER_CODES[value]] if isinstance(value, str) and value in FORMER_CODES else None


FORMER_CODES: Mapping[str, str] = {
    "EMPTY_CLOUD": "UNUSABLE_CLOUD",
    "NON_FINITE_POINTS": "UNUSABLE_CLOUD",
    "DEGENERATE_CLOUD": "UNUSABLE_CLOUD",
    "OUT_OF_RANGE": "UNUSABLE_CLOUD",
    "BAD_TRANSFORM": "BAD_FIELD",
    "STREAM_NOT_OPEN": "MALFORMED_BODY",
}
"""Former codes, and the one of today that asks the same of a client."""


class RevisitError(Exception):
    """Something went wrong."""

    code: ErrorCode = ErrorCode.INTERNAL

    def __init__(self, message: str | None = None, *, field: str | None = None, reason: str = "") -> None:
        """`field` names the offending input (`points`, `T_odom_sensor`, `k`), where there is one.

        `reason` is for logs and operators, `str` of the error, where they are told more than clients: names of hosts.
        """
        self.message = message or inspect.getdoc(type(self)) or type(self).__name__
        self.field = field
        self.reason = reason or self.message
        super().__init__(self.reason)


class MalformedBody(RevisitError):
    """The bytes cannot be parsed as the format they claim to be."""

    code = ErrorCode.MALFORMED_BODY


class EmptyCloud(RevisitError):
    """The cloud holds too few points to describe a place."""

    code = ErrorCode.UNUSABLE_CLOUD


class NonFinitePoints(RevisitError):
    """Too many points of the cloud are NaN or infinite."""

    code = ErrorCode.UNUSABLE_CLOUD


class DegenerateCloud(RevisitError):
    """The points are identical or lie on one line: no place can be described from them."""

    code = ErrorCode.UNUSABLE_CLOUD


class OutOfRange(RevisitError):
    """Coordinates lie beyond 10 km of the frame's origin: give metres, not millimetres; else re-base the origin."""

    code = ErrorCode.UNUSABLE_CLOUD


class BadTransform(RevisitError):
    """The transform is not a rigid motion."""

    code = ErrorCode.BAD_FIELD


class BadField(RevisitError):
    """A field has an unusable value."""

    code = ErrorCode.BAD_FIELD


class UnsupportedEncoding(RevisitError):
    """The content type or encoding is not supported."""

    code = ErrorCode.UNSUPPORTED_ENCODING


class TooLarge(RevisitError):
    """The body is larger than this service accepts."""

    code = ErrorCode.TOO_LARGE


class DescriptorModelMismatch(RevisitError):
    """The descriptors come from different models and cannot be compared."""

    code = ErrorCode.DESCRIPTOR_MODEL_MISMATCH


class DataLoss(RevisitError):
    """Stored data is damaged."""

    code = ErrorCode.DATA_LOSS


class MissingLibrary(ImportError):
    """A library of an extra is not installed; the message says which extra brings it."""


class FormerForm(DataLoss):
    """Stored data is of a form that is no longer read."""

    def __init__(self, noun: str, mended_by: str) -> None:
        """`noun` names what is stored, `mended_by` completes the sentence by the way to mend it."""
        super().__init__(f"the {noun} is of a form that this version no longer reads: {mended_by}")
