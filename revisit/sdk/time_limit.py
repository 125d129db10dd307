"""A limit on the time that calls may take, for a block of a program."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from revisit.sdk.errors import DeadlineExceeded, ErrorDetails, InvalidArgument

LEAST_S = 0.001

_ends_at: ContextVar[float | None] = ContextVar("revisit_calls_end_at", default=None)


@contextmanager
def within(timeout_s: float) -> Iterator[None]:
    """Calls in the block, with all that is repeated, take at most `timeout_s` together; within another, the shorter.

    A call that would take longer raises DeadlineExceeded (TIME_LIMIT). Raises InvalidArgument unless it is positive.
    """
    if not timeout_s > 0.0:
        raise InvalidArgument(
            ErrorDetails("INVALID_ARGUMENT", "BAD_FIELD", f"a time limit must be positive, got {timeout_s:g} s")
        )
    ends_at, outer = time.monotonic() + timeout_s, _ends_at.get()
    token = _ends_at.set(ends_at if outer is None else min(ends_at, outer))
    try:
        yield
    finally:
        _ends_at.reset(token)


def remaining_s(most_s: float) -> float:
    """How long a call may still take, at most `most_s`."""
    ends_at = _ends_at.get()
    return most_s if ends_at is None else min(most_s, max(ends_at - time.monotonic(), LEAST_S))


def exceeded(pause_s: float = 0.0) -> DeadlineExceeded | None:
    """The error to raise where the limit would be over after a pause; None before."""
    ends_at = _ends_at.get()
    if ends_at is None or time.monotonic() + pause_s < ends_at:
        return None
    message = "the service did not answer within the time limit of the program"
    return DeadlineExceeded(ErrorDetails("DEADLINE_EXCEEDED", "TIME_LIMIT", message))
