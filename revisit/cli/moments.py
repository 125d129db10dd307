"""Moments on the command line: a date, a date with a time, or nanoseconds since 1970."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

import typer

from revisit.cli.output import refuse

DAY_NS = 86_400 * 10**9

AsOf = Annotated[
    str,
    typer.Option(
        metavar="TIME", help="Only what was seen up to then: 2026-11-27, 2026-11-27T16:30, or nanoseconds since 1970."
    ),
]
Ever = Annotated[bool, typer.Option("--ever", help="Also what a later drive looked through.")]


def since_ns(text: str) -> int:
    """The moment after which all is that is not before `text`, of a date its beginning; 0 for "". Refuses as below."""
    found = moment_ns(text)
    return 0 if found is None else max(0, found - (DAY_NS if _is_date(text) else 1))


def moment_ns(text: str) -> int | None:
    """Nanoseconds since 1970 of a moment (UTC without a zone), of a date its end; None for "". Refuses other text."""
    if not text:
        return None
    if text.isascii() and text.isdigit():
        return int(text)
    try:
        found = datetime.fromisoformat(text)
    except ValueError as error:
        raise refuse(f"{text!r} is no time: 2026-11-27, 2026-11-27T16:30, or nanoseconds since 1970") from error
    dated = found if found.tzinfo else found.replace(tzinfo=UTC)
    return (int(dated.timestamp() * 1e6) * 1000) + (DAY_NS - 1 if _is_date(text) else 0)


def _is_date(text: str) -> bool:
    return "-" in text and len(text) <= len("2026-11-27")
