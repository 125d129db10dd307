"""Where a piece of work comes from: the request that asked for it, and its place in a distributed trace.

A transport says it once, at its outer edge; from there it goes with the call into logs, into jobs and so to workers.
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
    """What a span is: the answer to a request, or the run of a job."""

    REQUEST = "request"
    JOB = "job"


class Span:
    """A piece of work in a trace. This one is recorded nowhere; `traceparent` (W3C) is what it was given."""

    def __init__(self, traceparent: str | None = None) -> None:
        self.traceparent = traceparent

    def rename(self, name: str) -> None:
        """Give it a name that was not known at its begin, e.g. that of the route."""

    def note(self, **attributes: str | int | float | bool) -> None:
        """Say more about it."""

    def fail(self, reason: str) -> None:
        """Say that it did not end well."""


class Tracer(Protocol):
    """Makes spans."""

    def span(
        self, role: Role, name: str, traceparent: str | None, attributes: Mapping[str, str | int]
    ) -> AbstractContextManager[Span]:
        """A span around a block of code; `traceparent` names what it belongs to. An exception fails it."""
        ...

    def close(self) -> None:
        """Send what is left."""
        ...


class NoTracer:
    """`Tracer` that records nothing and hands a client's `traceparent` on."""

    @contextmanager
    def span(
        self, role: Role, name: str, traceparent: str | None, attributes: Mapping[str, str | int]
    ) -> Iterator[Span]:
        """See `Tracer`."""
        yield Span(traceparent)

    def close(self) -> None:
        """See `Tracer`."""


@dataclass(frozen=True)
class Origin:
    """The request behind what is being done, if there is one, and the span that it belongs to."""

    request_id: str | None = None
    span: Span = field(default_factory=Span)


_current: ContextVar[Origin | None] = ContextVar("origin", default=None)


def current_origin() -> Origin:
    """The origin of what is being done here; an empty one outside of any request or job."""
    return _current.get() or Origin()


@contextmanager
def originating(origin: Origin) -> Iterator[None]:
    """All that is done in the block comes from `origin`; its request id is in each line of the log."""
    before = _current.get()
    _enter(origin)
    try:
        yield
    finally:
        # Not by token: a stream that is given up may be closed in another context than it was begun in.
        _enter(before)


def _enter(origin: Origin | None) -> None:
    _current.set(origin)
    if origin is None:
        structlog.contextvars.unbind_contextvars("request_id")
    else:
        structlog.contextvars.bind_contextvars(request_id=origin.request_id)


def validated_traceparent(text: str | None) -> str | None:
    """`text` if it is a W3C traceparent of version 00, else None: what cannot be read is left out, as W3C asks."""
    return text if text is not None and _TRACEPARENT.fullmatch(text) else None
