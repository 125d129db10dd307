"""What the SDK makes of a gRPC failure that carries no details of the service."""

from __future__ import annotations

import grpc
import pytest

from revisit.sdk.errors import ApiError, Unavailable
from revisit.sdk.grpc_transport import _api_error


class Failure:
    """A failed call, as grpc tells of it."""

    def __init__(self, code: grpc.StatusCode) -> None:
        self._code = code

    def code(self) -> grpc.StatusCode:
        return self._code

    def details(self) -> str:
        return "gone"

    def trailing_metadata(self) -> tuple[tuple[str, bytes], ...]:
        return ()


@pytest.mark.parametrize("code", [grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.CANCELLED])
def test_a_service_that_ended_before_it_answered_is_asked_again(code):
    error = _api_error(Failure(code), "robot:1")
    assert isinstance(error, Unavailable)
    assert (error.retryable, error.reason) == (True, "UNREACHABLE")


def test_another_failure_is_told_as_it_is():
    error = _api_error(Failure(grpc.StatusCode.UNKNOWN), "robot:1")
    assert type(error) is ApiError
    assert (error.retryable, error.code) == (False, "UNKNOWN")
