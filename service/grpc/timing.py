"""How long unary calls take; a stream's length says nothing and is not measured."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from typing import Any

import grpc

from revisit.service.grpc.tracing import status_of
from revisit.service.metrics import RequestMetrics


class CallTimer(grpc.aio.ServerInterceptor):  # type: ignore[type-arg]  # not generic at run time
    """Measures each unary call under its method and status, from its head to its answer."""

    def __init__(self, requests: RequestMetrics) -> None:
        """Counts into `requests`."""
        self._requests = requests

    async def intercept_service(
        self,
        continuation: Callable[[grpc.HandlerCallDetails], Awaitable[Any]],
        handler_call_details: grpc.HandlerCallDetails,
    ) -> Any:
        """The handler of the call, wrapped where it is unary. Unknown methods have none and are not counted."""
        handler = await continuation(handler_call_details)
        if handler is None or handler.response_streaming:
            return handler
        method = str(handler_call_details.method)

        async def timed(requests: Any, context: Any) -> Any:
            began_s = time.perf_counter()
            try:
                return await handler.stream_unary(requests, context)
            finally:
                self._requests.observe("grpc", method, status_of(context), time.perf_counter() - began_s)

        return grpc.stream_unary_rpc_method_handler(timed, handler.request_deserializer, handler.response_serializer)
