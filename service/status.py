"""The one table of error codes on both transports.

`retryable` tells a client that repeating the same request, with the same ids, is the thing to do. A 4xx was
definitely not stored; after a 503 or 504 the outcome is unknown and the repeat settles it (docs/decisions/0022).
"""

from __future__ import annotations

from dataclasses import dataclass

from revisit.core.errors import ErrorCode

ERROR_DOMAIN = "revisit"


@dataclass(frozen=True)
class Status:
    """How an error code is answered; `grpc` is the canonical code's name."""

    http: int
    grpc: str
    retryable: bool = False


_INVALID = Status(422, "INVALID_ARGUMENT")
_CONFLICT = Status(409, "FAILED_PRECONDITION")
_RATE = Status(429, "RESOURCE_EXHAUSTED", retryable=True)
_UNAVAILABLE = Status(503, "UNAVAILABLE", retryable=True)

STATUS: dict[ErrorCode, Status] = {
    ErrorCode.MALFORMED_BODY: Status(400, "INVALID_ARGUMENT"),
    ErrorCode.UNUSABLE_CLOUD: _INVALID,
    ErrorCode.BAD_FIELD: _INVALID,
    ErrorCode.UNSUPPORTED_ENCODING: Status(415, "INVALID_ARGUMENT"),
    ErrorCode.TOO_LARGE: Status(413, "RESOURCE_EXHAUSTED"),
    ErrorCode.NOT_FOUND: Status(404, "NOT_FOUND"),
    ErrorCode.METHOD_NOT_ALLOWED: Status(405, "UNIMPLEMENTED"),
    ErrorCode.ALREADY_EXISTS: Status(409, "ALREADY_EXISTS"),
    ErrorCode.SESSION_FINISHED: _CONFLICT,
    ErrorCode.DESCRIPTOR_MODEL_MISMATCH: _CONFLICT,
    ErrorCode.NOT_READY: _CONFLICT,
    ErrorCode.SEQ_GAP: _CONFLICT,
    ErrorCode.STREAM_FENCED: _CONFLICT,
    ErrorCode.RATE: _RATE,
    ErrorCode.QUOTA: _RATE,
    ErrorCode.WORKERS_BUSY: _UNAVAILABLE,
    ErrorCode.DRAINING: _UNAVAILABLE,
    ErrorCode.STORAGE_UNCERTAIN: _UNAVAILABLE,
    ErrorCode.STORAGE_FULL: Status(507, "RESOURCE_EXHAUSTED", retryable=True),
    ErrorCode.DEADLINE_EXCEEDED: Status(504, "DEADLINE_EXCEEDED", retryable=True),
    ErrorCode.SEQ_NOT_REACHED: Status(504, "DEADLINE_EXCEEDED", retryable=True),
    ErrorCode.NO_ANSWER: Status(504, "DEADLINE_EXCEEDED", retryable=True),
    ErrorCode.UNAUTHENTICATED: Status(401, "UNAUTHENTICATED"),
    ErrorCode.PERMISSION_DENIED: Status(403, "PERMISSION_DENIED"),
    ErrorCode.EXTRA_MISSING: Status(501, "UNIMPLEMENTED"),
    ErrorCode.DATA_LOSS: Status(500, "DATA_LOSS"),
    ErrorCode.INTERNAL: Status(500, "INTERNAL"),
}


def retry_after_s(error: Exception, status: Status) -> float | None:
    """When a client may repeat the request, seconds; None where repeating is not the thing to do."""
    return float(getattr(error, "retry_after_s", 1.0)) if status.retryable else None
