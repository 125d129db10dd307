"""The named stages of the method, and how a caller learns how long each took.

A stage function carries its name: `@stage("bev")`. A caller that wants the times runs the method inside `stage_times`;
elsewhere a stage is a plain function call.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

_times: ContextVar[dict[str, float] | None] = ContextVar("_times", default=None)


def stage(name: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Makes a function the stage `name`."""

    def named(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def run(*args: P.args, **kwargs: P.kwargs) -> R:
            times = _times.get()
            if times is None:
                return function(*args, **kwargs)
            started = time.perf_counter()
            result = function(*args, **kwargs)
            times[name] = times.get(name, 0.0) + time.perf_counter() - started
            return result

        return run

    return named


@contextmanager
def stage_times() -> Iterator[dict[str, float]]:
    """The seconds of each stage that ends inside the block, by name; those of a stage that runs twice are added up."""
    times: dict[str, float] = {}
    token = _times.set(times)
    try:
        yield times
    finally:
        _times.reset(token)
