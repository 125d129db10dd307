"""Refusals of the service as exceptions: one class per canonical code, with the reason of the error table."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ErrorDetails:
    """The content of an error answer."""

    code: str
    reason: str
    message: str
    retryable: bool = False
    request_id: str = ""
    field: str | None = None
    retry_after_s: float | None = None
    expected_seq: int | None = None


class ApiError(Exception):
    """The service refused a call, or could not be reached (reason UNREACHABLE)."""

    def __init__(self, details: ErrorDetails) -> None:
        super().__init__(f"{details.reason}: {details.message}")
        self.code = details.code
        self.reason = details.reason
        self.message = details.message
        self.retryable = details.retryable
        self.request_id = details.request_id
        self.field = details.field
        self.retry_after_s = details.retry_after_s
        self.expected_seq = details.expected_seq


class InvalidArgument(ApiError):
    """The input cannot be used; nothing was stored."""


class NotFound(ApiError):
    """There is no such resource."""


class AlreadyExists(ApiError):
    """The id is taken by other content."""


class FailedPrecondition(ApiError):
    """The resource is in a state that does not allow this."""


class ResourceExhausted(ApiError):
    """Too large, or over a quota."""


class Unavailable(ApiError):
    """The service cannot answer now; the outcome is unknown until the call is repeated with the same ids."""


class DeadlineExceeded(ApiError):
    """The answer took too long."""


class Unauthenticated(ApiError):
    """The API key is missing, wrong, expired or revoked."""


class PermissionDenied(ApiError):
    """The API key does not reach so far."""


class DataLoss(ApiError):
    """Stored data is damaged."""


class OperationFailed(ApiError):
    """An operation that was waited for ended in failure."""


_CLASSES: dict[str, type[ApiError]] = {
    "INVALID_ARGUMENT": InvalidArgument,
    "NOT_FOUND": NotFound,
    "ALREADY_EXISTS": AlreadyExists,
    "FAILED_PRECONDITION": FailedPrecondition,
    "RESOURCE_EXHAUSTED": ResourceExhausted,
    "UNAVAILABLE": Unavailable,
    "DEADLINE_EXCEEDED": DeadlineExceeded,
    "UNAUTHENTICATED": Unauthenticated,
    "PERMISSION_DENIED": PermissionDenied,
    "DATA_LOSS": DataLoss,
}

_SIGNS = (
    ("illegal request line", "is this the gRPC port? REST has another one, 8080 by default"),
    ("Expected SETTINGS frame", "is this the REST port? gRPC has another one, 8090 by default"),
    ("Misformatted domain name", "the address of gRPC is host:port, without http://, e.g. 127.0.0.1:8090"),
    ("WRONG_VERSION_NUMBER", "no TLS is spoken there: write http:// for REST, and gRPC without grpcs://"),
)
"""Libraries' words for an address that is not the service's, and the advice."""


_DISTRUST = (
    ("certificate is not valid for", "is for another name than this address: write the name that it holds"),
    ("Hostname Verification Check failed", "is for another name than this address: write the name that it holds"),
    ("certificate has expired", "has expired: renew it, or set the clock of this machine"),
    ("certificate is not yet valid", "is not valid yet: set the clock of this machine"),
    ("CERTIFICATE_VERIFY_FAILED", "is signed by an unknown authority; set REVISIT_CA to its file"),
)
"""Libraries' words for an untrusted certificate, and its defect."""


def error_of(details: ErrorDetails) -> ApiError:
    """The exception for an error answer."""
    return _CLASSES.get(details.code, ApiError)(details)


def unreachable(address: str, cause: object) -> Unavailable:
    """The service did not answer at all; the message has advice."""
    text = str(cause).rstrip(".")
    distrust = next((wrong for sign, wrong in _DISTRUST if sign in text), None)
    advice = next((advice for sign, advice in _SIGNS if sign in text), "is it running? `revisit serve` starts it")
    message = f"{text} - {advice}" if distrust is None else f"the service's certificate {distrust}"
    return Unavailable(ErrorDetails("UNAVAILABLE", "UNREACHABLE", f"no answer from {address}: {message}", True))


def closed() -> FailedPrecondition:
    """The stream was closed while somebody waited for it."""
    return FailedPrecondition(ErrorDetails("FAILED_PRECONDITION", "CLOSED", "the stream was closed"))


class NoWorker(UserWarning):
    """An operation waits for a worker, and none is ready."""
