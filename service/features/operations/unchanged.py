"""Work on rows that others may change meanwhile: it is committed if they are the same then, else done again."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from revisit.service.domain.errors import Unavailable

READINGS = 3
"""Attempts, where nobody says."""

T = TypeVar("T")


def unchanged(attempt: Callable[[], T], message: str, readings: int = READINGS) -> T:
    """The result of the first attempt that found its rows unchanged; of others it is false.

    Raises Unavailable with the `message` after so many `readings`.
    """
    for _ in range(readings):
        if result := attempt():
            return result
    raise Unavailable(message)
