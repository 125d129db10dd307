"""Errors as google.rpc.Status, all from `service.status.STATUS`; one interceptor for every RPC.

The interceptor also parses: handlers receive the message's bytes from gRPC, so that what does not parse is
INVALID_ARGUMENT (gRPC itself would answer INTERNAL or UNKNOWN with the name of an exception class).
"""

from __future__ import annotations

import uuid
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any, NoReturn

import grpc
import structlog
from google.protobuf.duration_pb2 import Duration
from google.protobuf.message import DecodeError, Message
from google.rpc import error_details_pb2, status_pb2  # type: ignore[import-untyped]  # ships no types

from revisit.core.errors import MalformedBody, RevisitError
from revisit.service.application.contract.tracing import current_request
from revisit.service.grpc.access import Gate
from revisit.service.grpc.tracing import OWN_METHODS, REQUEST_ID
from revisit.service.status import ERROR_DOMAIN, STATUS, retry_after_s

STATUS_DETAILS = "grpc-status-details-bin"
MAX_MESSAGE_CHARACTERS = 800

_log = structlog.get_logger(__name__)


class ErrorInterceptor(grpc.aio.ServerInterceptor):  # type: ignore[type-arg]  # not generic at run time
    """Turns what a handler raises into a status with details, for unary calls and streams; admits before it parses."""

    def __init__(self, gate: Gate) -> None:
        """`gate` admits the callers."""
        self._gate = gate

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Any]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Any:
        """The handler of the call, wrapped where it is one of ours."""
        handler = await continuation(handler_call_details)
        method = str(handler_call_details.method)
        if handler is None or not method.startswith(OWN_METHODS):
            return handler
        return _guarded(handler, method, self._gate)


def rpc_status(error: RevisitError, request_id: str) -> status_pb2.Status:
    """The google.rpc.Status of an error: ErrorInfo, RequestInfo and, where they apply, BadRequest and RetryInfo."""
    status = STATUS[error.code]
    metadata = {"retryable": str(status.retryable).lower()}
    expected = getattr(error, "expected", None)
    if isinstance(expected, int):
        metadata["expected_seq"] = str(expected)
    details: list[Message] = [
        error_details_pb2.ErrorInfo(reason=error.code.value, domain=ERROR_DOMAIN, metadata=metadata),
        error_details_pb2.RequestInfo(request_id=request_id),
    ]
    message = error.message[:MAX_MESSAGE_CHARACTERS]
    if error.field is not None:
        violation = error_details_pb2.BadRequest.FieldViolation(field=error.field[:100], description=message)
        details.append(error_details_pb2.BadRequest(field_violations=[violation]))
    delay_s = retry_after_s(error, status)
    if delay_s is not None:
        delay = Duration(seconds=int(delay_s), nanos=int(delay_s % 1 * 1e9))
        details.append(error_details_pb2.RetryInfo(retry_delay=delay))
    result = status_pb2.Status(code=code_of(error).value[0], message=message)
    for detail in details:
        result.details.add().Pack(detail)
    return result


def code_of(error: RevisitError) -> grpc.StatusCode:
    """The canonical code of an error."""
    return grpc.StatusCode[STATUS[error.code].grpc]


def _guarded(handler: Any, method: str, gate: Gate) -> Any:
    parse = handler.request_deserializer
    if handler.request_streaming and handler.response_streaming:

        async def stream_stream(requests: AsyncIterator[bytes], context: Any) -> AsyncIterator[Any]:
            try:
                async with gate.watching(method, context):
                    async for response in handler.stream_stream(_parsed(parse, requests), context):
                        yield response
            except Exception as error:  # noqa: BLE001  # the last resort of every call
                await _abort(context, error)

        return grpc.stream_stream_rpc_method_handler(stream_stream, None, handler.response_serializer)
    if handler.response_streaming:

        async def unary_stream(request: bytes, context: Any) -> AsyncIterator[Any]:
            try:
                async with gate.watching(method, context):
                    async for response in handler.unary_stream(_parse(parse, request), context):
                        yield response
            except Exception as error:  # noqa: BLE001  # the last resort of every call
                await _abort(context, error)

        return grpc.unary_stream_rpc_method_handler(unary_stream, None, handler.response_serializer)

    async def unary_unary(request: bytes, context: Any) -> Any:
        try:
            await gate.admit(method, context)
            return await handler.unary_unary(_parse(parse, request), context)
        except Exception as error:  # noqa: BLE001  # the last resort of every call
            await _abort(context, error)

    return grpc.unary_unary_rpc_method_handler(unary_unary, None, handler.response_serializer)


async def _parsed(parse: Callable[[bytes], Any], requests: AsyncIterator[bytes]) -> AsyncIterator[Any]:
    async for request in requests:
        yield _parse(parse, request)


def _parse(parse: Callable[[bytes], Any], request: bytes) -> Any:
    try:
        return parse(request)
    except DecodeError as error:
        raise MalformedBody("the message is not valid protobuf of its type") from error


async def _abort(context: Any, error: Exception) -> NoReturn:
    if isinstance(error, grpc.aio.AbortError):
        raise error
    request_id = current_request().request_id or uuid.uuid4().hex
    if not isinstance(error, RevisitError):
        _log.exception("call failed unexpectedly", request_id=request_id, exc_info=error)
        error = RevisitError("an internal error occurred; the request id leads to its log entry")
    status = rpc_status(error, request_id)
    trailing = ((STATUS_DETAILS, status.SerializeToString()), (REQUEST_ID, request_id))
    await context.abort(code_of(error), status.message, trailing)
    raise AssertionError("abort does not return")
