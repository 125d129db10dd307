"""Extras of the distribution that commands need, and the advice where one is not installed."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Literal, ParamSpec, TypeVar

DISTRIBUTION = "revisit-loops"

Extra = Literal["cli", "service", "evaluation", "crs"]
P = ParamSpec("P")
R = TypeVar("R")


def needs(extra: Extra) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Mark a command that needs an extra: without it the command ends with one line and exit status 1."""

    def marked(command: Callable[P, R]) -> Callable[P, R]:
        @wraps(command)
        def checked(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                return command(*args, **kwargs)
            except ImportError as error:
                raise SystemExit(what_is_missing(extra, error)) from error

        return checked

    return marked


def what_is_missing(extra: Extra, error: ImportError) -> str:
    """The advice in one line: install `extra`, or as the error itself says.

    Raises `error` where a part of Revisit's own is missing.
    """
    if error.name is None or error.name.partition(".")[0] == "revisit":
        raise error
    if not isinstance(error, ModuleNotFoundError):
        return f"revisit: {error}"
    return f"revisit: {error.name} is not installed; this needs: pip install '{DISTRIBUTION}[{extra}]'"
