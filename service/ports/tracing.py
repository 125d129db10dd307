"""Which request a piece of work belongs to, and its place in a distributed trace.

A transport sets the request context when a call arrives. It goes with the call into logs and jobs, and with the job to
a worker.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

import structlog

_TRACEPARENT = re.compile(r"00-(?!0{32})[0-9a-f]{32}-(?!0{16})[0-9a-f]{16}-[0-9a-f]{2}", re.ASCII)


class Role(StrEnum):
    """The kind of a span: the answer to a request, or the run of a job."""

    REQUEST = "request"
    JOB = "job"


class Span:
    """A piece of work in a trace. This one is recorded nowhere; `traceparent` (W3C) is the one it was given."""

    def __init__(self, traceparent: str | None = None) -> None:
        self.traceparent = traceparent

    def rename(self, name: str) -> None:
        """Set a name that was not known when it began, e.g. that of the route."""

    def note(self, **attributes: str | int | float | bool) -> None:
        """Add attributes."""

    def fail(self, reason: str) -> None:
        """Mark it as failed."""


class Tracer(Protocol):
    """Makes spans."""

    def span(
        self, role: Role, name: str, traceparent: str | None, attributes: Mapping[str, str | int]
    ) -> AbstractContextManager[Span]:
        """A span around a block of code, child of `traceparent`. An exception marks it as failed."""
        ...

    def close(self) -> None:
        """Send the remaining spans."""
        ...


class NoTracer:
    """`Tracer` that records nothing and passes a client's `traceparent` on."""

    @contextmanager
    def span(
        self, role: Role, name: str, traceparent: str | None, attributes: Mapping[str, str | int]
    ) -> Iterator[Span]:
        """See `Tracer`."""
        yield Span(traceparent)

    def close(self) -> None:
        """See `Tracer`."""


@dataclass(frozen=True)
class RequestContext:
    """The request that caused some work, if there is one, and the span around the work."""

    request_id: str | None = None
    span: Span = field(default_factory=Span)


_current: ContextVar[RequestContext | None] = ContextVar("request_context", default=None)


def current_request() -> RequestContext:
    """The context of the current request or job; an empty one outside of both."""
    return _current.get() or RequestContext()


@contextmanager
def within_request(request: RequestContext) -> Iterator[None]:
    """Make `request` the current one within the block; its id is in each line of the log."""
    before = _current.get()
    _enter(request)
    try:
        yield
    finally:
        # Not by token: a stream that is given up may be closed in another context than it was begun in.
        _enter(before)


def _enter(request: RequestContext | None) -> None:
    _current.set(request)
    if request is None:
        structlog.contextvars.unbind_contextvars("request_id")
    else:
        structlog.contextvars.bind_contextvars(request_id=request.request_id)


def validated_traceparent(text: str | None) -> str | None:
    """`text` if it is a W3C traceparent of version 00, else None: W3C asks that an unreadable one be ignored."""
    return text if text is not None and _TRACEPARENT.fullmatch(text) else None
