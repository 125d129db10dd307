"""Pure ASGI middleware around every request: its id, safe headers, authorisation, the body's limits, its duration."""

from __future__ import annotations

import asyncio
import ipaddress
import re
import time
from contextlib import ExitStack

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from revisit.core.errors import MalformedBody, RevisitError, TooLarge
from revisit.service.capacity.byte_budget import ByteBudget, HeldBytes
from revisit.service.domain.callers import current_tenant_or_none
from revisit.service.domain.errors import DeadlineExceeded, WorkersBusy
from revisit.service.domain.identity import TenantId
from revisit.service.edge.requests import REQUEST_ID, request_id_of
from revisit.service.metrics import RequestMetrics
from revisit.service.rest.errors import REFUSED, ForeignOrigin, UnknownHost, problem, unexpected
from revisit.service.rest.limits import HttpLimits
from revisit.service.rest.tracing import call_of

_PORT = re.compile(r":[0-9]*$", re.ASCII)

SECURITY_HEADERS = {
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
}
STRICTER = ("cache-control", "content-security-policy")
"""Those that an answer may bring itself."""


NOBODY = TenantId("")
"""The holder of bytes before anybody was admitted."""

HEALTH_PATHS = frozenset({"/livez", "/readyz"})

CLOSE = {"connection": "close"}
"""The header of an answer after which the connection is closed."""

HSTS = {"strict-transport-security": "max-age=31536000"}
"""Over TLS: for a year browsers do not come back without it."""


class RequestEnvelope:
    """Gives each request an id (the client's `X-Request-Id` where it is well formed) and each answer safe headers."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one ASGI connection."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id = request_id_of(Headers(scope=scope).get(REQUEST_ID))
        scope.setdefault("state", {})["request_id"] = request_id
        headers = {**SECURITY_HEADERS, **(HSTS if scope["scheme"] == "https" else {}), REQUEST_ID: request_id}
        started = False

        async def send_with_headers(message: Message) -> None:
            nonlocal started
            if message["type"] == "http.response.start":
                started = True
                own = MutableHeaders(scope=message)
                own.update(headers | {name: own[name] for name in STRICTER if name in own})
            await send(message)

        try:
            await self._app(scope, receive, send_with_headers)
        except Exception as error:
            if started:
                raise
            await unexpected(error, request_id)(scope, receive, send_with_headers)


class RequestSlots:
    """Refuses a request where as many as may be are being answered; health is told in any case.

    A request's resources from its admission on, in `scope["state"]["held"]`, are released once it is answered.
    """

    def __init__(self, app: ASGIApp, limits: HttpLimits) -> None:
        self._app = app
        self._limits = limits
        self._answering = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one ASGI connection."""
        if scope["type"] != "http" or scope["path"] in HEALTH_PATHS:
            await self._app(scope, receive, send)
            return
        if self._answering >= self._limits.requests:
            refusal = WorkersBusy("too many requests are being answered; try again later with the same id")
            await problem(refusal, scope["state"]["request_id"], CLOSE)(scope, receive, send)
            return
        self._answering += 1
        try:
            with ExitStack() as scope["state"]["held"]:
                await self._app(scope, receive, send)
        finally:
            self._answering -= 1


class OriginGuard:
    """Refuses changes that a browser sends for a page of another origin: there may be no key that protects them."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one ASGI connection."""
        if scope["type"] == "http" and scope["method"] not in ("GET", "HEAD") and _is_foreign(Headers(scope=scope)):
            await problem(ForeignOrigin(), scope["state"]["request_id"])(scope, receive, send)
            return
        await self._app(scope, receive, send)


class HostGuard:
    """Answers only to names it knows, so that no page can reach it under a name of its own (DNS rebinding).

    An IP address is always taken: a browser that sends one shows no page of another name.
    """

    def __init__(self, app: ASGIApp, hosts: frozenset[str]) -> None:
        self._app = app
        self._hosts = hosts | {"localhost"}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one ASGI connection."""
        if scope["type"] == "http" and "*" not in self._hosts and not self._knows(Headers(scope=scope).get("host", "")):
            await problem(UnknownHost(), scope["state"]["request_id"])(scope, receive, send)
            return
        await self._app(scope, receive, send)

    def _knows(self, host: str) -> bool:
        name = _PORT.sub("", host).lower().removesuffix(".")
        return name in self._hosts or _is_address(name.removeprefix("[").removesuffix("]"))


class BodyLimit:
    """Refuses a body that is too large or too slow, by its declared length before reading or while it streams in.

    All bodies together are bounded too, by the budget: each counts until its answer is sent.
    """

    def __init__(self, app: ASGIApp, limits: HttpLimits) -> None:
        self._app = app
        self._limits = limits

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one ASGI connection."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        budget: ByteBudget = scope["app"].state.use_cases.budget
        refusal = _two_lengths(headers) or self._refusal(budget, headers.get("content-length", "0"))
        if refusal is not None:
            # The next bytes on this connection may be a second request that was hidden in the first.
            await problem(refusal, scope["state"]["request_id"], CLOSE)(scope, receive, send)
            return
        body = _Body(receive, self._limits)
        with ExitStack() as until_answered:
            held: HeldBytes | None = None

            async def receive_within_limits() -> Message:
                nonlocal held
                message = await body.receive()
                if held is None and body.read_bytes > 0:
                    # A body is read only after its caller was admitted.
                    held = until_answered.enter_context(budget.hold(current_tenant_or_none() or NOBODY))
                if held is not None:
                    held.set(body.read_bytes)
                return message

            await self._app(scope, receive_within_limits, send)
            unread_bytes = int(headers.get("content-length", "0")) - body.read_bytes
            if unread_bytes > 0:
                # The connection goes on, so the rest is still read, and thrown away.
                scope["app"].state.use_cases.access.note_unread(unread_bytes)

    def _refusal(self, budget: ByteBudget, declared: str) -> RevisitError | None:
        if not declared.isascii() or not declared.isdigit():
            return MalformedBody("Content-Length is not a number")
        if int(declared[:20]) > self._limits.body_bytes:
            return _too_large(self._limits)
        if int(declared) > 0 and not budget.has_room(NOBODY, int(declared)):
            return WorkersBusy("too many bodies are being read; try again later with the same id")
        return None


class _Body:
    """One body as it comes in, with its size and its pace."""

    def __init__(self, receive: Receive, limits: HttpLimits) -> None:
        self.read_bytes = 0
        self._receive = receive
        self._limits = limits
        self._began_s = asyncio.get_running_loop().time()
        self._complete = False

    async def receive(self) -> Message:
        """The next part. Raises TooLarge, DeadlineExceeded."""
        if self._complete:
            return await self._receive()
        allowed_s = self._limits.body_grace_s + self.read_bytes / self._limits.body_bytes_per_s
        try:
            async with asyncio.timeout_at(self._began_s + allowed_s):
                message = await self._receive()
        except TimeoutError as error:
            raise DeadlineExceeded("the body came too slowly: repeat the request with the same id") from error
        self.read_bytes += len(message.get("body", b""))
        self._complete = not message.get("more_body", False)
        if self.read_bytes > self._limits.body_bytes:
            raise _too_large(self._limits)
        return message


class RequestTimer:
    """Measures how long each request took, under its route and status, and counts refusals by their reason."""

    def __init__(self, app: ASGIApp, requests: RequestMetrics) -> None:
        self._app = app
        self._requests = requests

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one ASGI connection."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        began_s, status, state = time.perf_counter(), 500, scope.setdefault("state", {})

        async def send_noting(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        try:
            await self._app(scope, receive, send_noting)
        finally:
            self._requests.observe("http", call_of(scope), str(status), time.perf_counter() - began_s)
            if REFUSED in state:
                self._requests.refuse("http", state[REFUSED])


def _two_lengths(headers: Headers) -> RevisitError | None:
    """Where a proxy believes one length and we the other, a second request could hide in the first (RFC 9112 6.1)."""
    if "transfer-encoding" in headers and "content-length" in headers:
        return MalformedBody("a body has either a Content-Length or a Transfer-Encoding")
    return None


def _too_large(limits: HttpLimits) -> TooLarge:
    return TooLarge(f"a body may have at most {limits.body_bytes} bytes")


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True


def _is_foreign(headers: Headers) -> bool:
    origin = headers.get("origin")
    return origin is not None and origin.partition("://")[2] != headers.get("host")
