"""Tracing of HTTP requests: each has a request id, a span and a line in the log."""

from __future__ import annotations

import time

import structlog
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from revisit.service.ports.tracing import (
    RequestContext,
    Role,
    Tracer,
    validated_traceparent,
    within_request,
)

PROBES = ("/livez", "/readyz")

METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})

log = structlog.get_logger(__name__)


def call_of(scope: Scope) -> str:
    """The name of a call: method and pattern of the route, never a client's free text, so that there are few."""
    method = scope["method"] if scope["method"] in METHODS else "other"
    return f"{method} {scope['route'].path}" if "route" in scope else "unmatched"


class RequestTracing:
    """Sets the request context of each request: its id, and a span within the trace that the client names."""

    def __init__(self, app: ASGIApp, tracer: Tracer) -> None:
        self._app = app
        self._tracer = tracer

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one ASGI connection."""
        if scope["type"] != "http" or scope["path"] in PROBES:
            await self._app(scope, receive, send)
            return
        began_s, status = time.perf_counter(), 500
        request_id, method = scope["state"]["request_id"], scope["method"]
        given = validated_traceparent(Headers(scope=scope).get("traceparent"))

        async def send_noting(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        about = {"http.request.method": method, "revisit.request_id": request_id}
        with (
            self._tracer.span(Role.REQUEST, "request", given, about) as span,
            within_request(RequestContext(request_id, span)),
        ):
            try:
                await self._app(scope, receive, send_noting)
            finally:
                call = call_of(scope)
                span.rename(call)
                span.note(**{"http.response.status_code": status})
                if status >= 500:
                    span.fail(str(status))
                took_ms = round(1000 * (time.perf_counter() - began_s), 1)
                log.info("request", call=call, status=status, took_ms=took_ms)
