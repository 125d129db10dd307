"""How long unary calls take, and why calls are refused; a stream's length says nothing and is not measured."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from typing import Any

import grpc

from revisit.service.grpc.tracing import Wrapping, reason_of, status_of
from revisit.service.metrics import RequestMetrics


class CallTimer(Wrapping):
    """Measures each unary call under its method and status, from its head to its answer; counts refusals of all."""

    def __init__(self, requests: RequestMetrics) -> None:
        """Counts into `requests`."""
        self._requests = requests

    def wrapped(self, handler: Any, method: str) -> Any:
        """See `Wrapping`."""
        parts = (handler.request_deserializer, handler.response_serializer)
        if handler.response_streaming:

            async def watched(requests: Any, context: Any) -> AsyncIterator[Any]:
                try:
                    async for response in handler.stream_stream(requests, context):
                        yield response
                finally:
                    self._count_refusal(context)

            return grpc.stream_stream_rpc_method_handler(watched, *parts)

        async def timed(requests: Any, context: Any) -> Any:
            began_s = time.perf_counter()
            try:
                return await handler.stream_unary(requests, context)
            finally:
                self._requests.observe("grpc", method, status_of(context), time.perf_counter() - began_s)
                self._count_refusal(context)

        return grpc.stream_unary_rpc_method_handler(timed, *parts)

    def _count_refusal(self, context: Any) -> None:
        reason = reason_of(context)
        if reason is not None:
            self._requests.refuse("grpc", reason)
