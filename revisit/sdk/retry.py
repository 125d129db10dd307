"""Repeat retryable calls, after full-jitter pauses. Safe for every call: creates carry client-chosen ids."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from revisit.sdk.errors import ApiError
from revisit.sdk.time_limit import exceeded

T = TypeVar("T")

WAITED_FOR = ("SEQ_NOT_REACHED", "NO_ANSWER")
"""The service has waited as long as the caller allowed: only the caller knows whether to wait longer."""


@dataclass(frozen=True)
class RetryPolicy:
    """At most `attempts` calls; pauses uniform in 0..min(cap_s, base_s * 2^n), never shorter than the server asks."""

    attempts: int = 5
    base_s: float = 0.2
    cap_s: float = 5.0

    def pause_s(self, failures: int, asked_s: float | None = None) -> float:
        """The pause after the n-th failure, n from 1, seconds."""
        jitter_s = random.uniform(0.0, min(self.cap_s, self.base_s * 2.0 ** min(failures, 30)))
        return max(asked_s or 0.0, jitter_s)

    def run(self, call: Callable[[], T]) -> T:
        """The result of `call`. Raises its last ApiError, and DeadlineExceeded where a `time_limit` is over."""
        for failures in range(1, self.attempts):
            try:
                return _in_time(call)
            except ApiError as error:
                if not error.retryable or error.reason in WAITED_FOR:
                    raise
                pause_s = self.pause_s(failures, error.retry_after_s)
                if late := exceeded(pause_s):
                    raise late from error
                time.sleep(pause_s)
        return _in_time(call)


def _in_time(call: Callable[[], T]) -> T:
    """The result of a call; an error of one that the time limit has ended says so."""
    try:
        return call()
    except ApiError as error:
        if late := exceeded():
            raise late from error
        raise
