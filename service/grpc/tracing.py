"""Tracing of gRPC calls: each has a request id, a span and a line in the log."""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any

import grpc
import structlog
from google.rpc import error_details_pb2, status_pb2  # type: ignore[import-untyped]  # ships no types

from revisit.core.errors import ErrorCode
from revisit.service.edge.requests import REQUEST_ID, request_id_of
from revisit.service.ports.tracing import (
    RequestContext,
    Role,
    Tracer,
    validated_traceparent,
    within_request,
)

STATUS_DETAILS = "grpc-status-details-bin"

OWN_METHODS = "/revisit."

log = structlog.get_logger(__name__)


class Wrapping(grpc.aio.ServerInterceptor):  # type: ignore[type-arg]  # not generic at run time
    """An interceptor that gives each call another handler. An unknown method has none."""

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Any]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Any:
        """The handler of the call, wrapped."""
        handler = await continuation(handler_call_details)
        return None if handler is None else self.wrapped(handler, str(handler_call_details.method))

    @abstractmethod
    def wrapped(self, handler: Any, method: str) -> Any:
        """The handler in place of that of `method`."""


class CallTracing(Wrapping):
    """Sets the request context of each call: its id, and a span within the trace that the client names.

    It comes before `ErrorInterceptor`, which has made every handler one that reads its messages itself.
    """

    def __init__(self, tracer: Tracer) -> None:
        """Spans are made by `tracer`."""
        self._tracer = tracer

    def wrapped(self, handler: Any, method: str) -> Any:
        """See `Wrapping`: calls of others are left alone."""
        if not method.startswith(OWN_METHODS):
            return handler
        parts = (handler.request_deserializer, handler.response_serializer)
        if not handler.response_streaming:

            async def unary(requests: Any, context: Any) -> Any:
                with self._call(method, context):
                    return await handler.stream_unary(requests, context)

            return grpc.stream_unary_rpc_method_handler(unary, *parts)

        async def stream(requests: Any, context: Any) -> AsyncIterator[Any]:
            with self._call(method, context):
                async for response in handler.stream_stream(requests, context):
                    yield response

        return grpc.stream_stream_rpc_method_handler(stream, *parts)

    @contextmanager
    def _call(self, method: str, context: Any) -> Iterator[None]:
        began_s, sent = time.perf_counter(), dict(context.invocation_metadata() or ())
        request_id = request_id_of(sent.get(REQUEST_ID))
        context.set_trailing_metadata(((REQUEST_ID, request_id),))
        about = {"rpc.system": "grpc", "rpc.method": method, "revisit.request_id": request_id}
        given = validated_traceparent(_text(sent.get("traceparent")))
        with (
            self._tracer.span(Role.REQUEST, method, given, about) as span,
            within_request(RequestContext(request_id, span)),
        ):
            try:
                yield
            finally:
                status = status_of(context)
                span.note(**{"rpc.grpc.status": status})
                took_ms = round(1000 * (time.perf_counter() - began_s), 1)
                log.info("request", call=method, status=status, took_ms=took_ms)


def status_of(context: Any) -> str:
    """The name of the status that a call has got; OK where none was set."""
    return grpc.StatusCode(context.code()).name if context.code() else "OK"


def reason_of(context: Any) -> ErrorCode | None:
    """Why a call was refused; None for one that was not."""
    details = dict(context.trailing_metadata() or ()).get(STATUS_DETAILS)
    if details is None:
        return None
    info = error_details_pb2.ErrorInfo()
    status_pb2.Status.FromString(details).details[0].Unpack(info)
    return ErrorCode(info.reason)


def _text(value: object) -> str | None:
    return value if isinstance(value, str) else None
