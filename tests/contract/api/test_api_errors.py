"""Every error code over both transports: one table, which the SDK reads back as the same exception."""

from __future__ import annotations

import json

import grpc
import httpx
import pytest
import structlog
from google.rpc import error_details_pb2

from revisit.core.errors import ErrorCode, RevisitError
from revisit.sdk import errors as of_sdk
from revisit.sdk.grpc_transport import _api_error
from revisit.sdk.rest_transport import _details
from revisit.service.grpc.errors import code_of, rpc_status
from revisit.service.grpc.tracing import STATUS_DETAILS
from revisit.service.rest.errors import problem
from revisit.service.status import STATUS
from tests.support.service_world import cloud_points, pose


class Refused(RevisitError):
    """An error as hostile input could make it, with everything that an error can carry."""

    def __init__(self, code: ErrorCode) -> None:
        super().__init__("é\x1b[31m\r\n" * 5000, field="points")
        self.code, self.expected, self.retry_after_s = code, 7, 3.0


class Failure(grpc.RpcError):
    """A failed call, as the client's side of gRPC tells of it."""

    def __init__(self, error: RevisitError) -> None:
        self.status = rpc_status(error, "some-id")
        self._code = code_of(error)

    def code(self) -> grpc.StatusCode:
        return self._code

    def trailing_metadata(self) -> tuple[tuple[str, bytes], ...]:
        return ((STATUS_DETAILS, self.status.SerializeToString()),)


@pytest.mark.parametrize("code", list(ErrorCode))
def test_a_code_is_the_same_error_over_both_transports(code):
    answer, failure = problem(Refused(code), "some-id"), Failure(Refused(code))
    body, status = json.loads(answer.body), STATUS[code]
    assert answer.status_code == body["status"] == status.http and 400 <= status.http < 600
    assert len(answer.body) <= 4096 and body["detail"].isascii() and body["detail"].isprintable()
    assert failure.status.code == failure.code().value[0]
    info = error_details_pb2.ErrorInfo()
    assert failure.status.details[0].Unpack(info) and info.domain == "revisit"
    rest = of_sdk.error_of(_details(httpx.Response(answer.status_code, headers=answer.headers, content=answer.body)))
    rpc = _api_error(failure, "robot:1")
    assert type(rest) is type(rpc) and (rest.message[0], rpc.message[0]) == ("?", "é")
    assert {**vars(rest), "message": ""} == {**vars(rpc), "message": ""}
    assert (rest.code, rest.reason, rest.retryable) == (status.grpc, code.value, status.retryable)
    assert (rest.field, rest.expected_seq, rest.request_id) == ("points", 7, "some-id")
    assert rest.retry_after_s == (3.0 if status.retryable else None)


def test_a_draining_service_refuses_new_work_and_says_when_to_come_back(client, session, service):
    stopping = service.world.context.stopping
    stopping.set()
    try:
        with pytest.raises(of_sdk.Unavailable) as refused:
            client.post_submap(session, "late", cloud_points(1), pose(), 1)
    finally:
        stopping.clear()
    assert (refused.value.reason, refused.value.retryable) == ("DRAINING", True)
    assert refused.value.retry_after_s > 0


def test_a_defect_is_answered_without_its_details(client, service, monkeypatch):
    async def broken(*_):
        raise ZeroDivisionError("secret detail")

    monkeypatch.setattr(service.world.use_cases.maps, "get", broken)
    with structlog.testing.capture_logs() as logs, pytest.raises(of_sdk.ApiError) as refused:
        client.get_map("maps/any")
    (entry,) = (log for log in logs if log["event"] != "request")
    assert isinstance(entry["exc_info"], ZeroDivisionError)
    assert (refused.value.reason, refused.value.request_id) == ("INTERNAL", entry["request_id"])
    assert "secret" not in str(refused.value) and "ZeroDivision" not in str(refused.value)
