"""Moments on the command line: a date, a date with a time, or nanoseconds since 1970."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

import typer

from revisit.cli.output import refuse

AsOf = Annotated[
    str,
    typer.Option(
        metavar="TIME", help="Only what was seen up to then: 2026-11-27, 2026-11-27T16:30, or nanoseconds since 1970."
    ),
]
Ever = Annotated[bool, typer.Option("--ever", help="Also what a later drive looked through.")]


def moment_ns(text: str) -> int | None:
    """Nanoseconds since 1970 of a moment (UTC without a zone), of a date its end; None for "". Refuses other text."""
    if not text:
        return None
    if text.isdigit():
        return int(text)
    try:
        found = datetime.fromisoformat(text)
    except ValueError as error:
        raise refuse(f"{text!r} is no time: 2026-11-27, 2026-11-27T16:30, or nanoseconds since 1970") from error
    whole_day_s = 86_400 if len(text) <= len("2026-11-27") else 0
    dated = found if found.tzinfo else found.replace(tzinfo=UTC)
    return (int(dated.timestamp() * 1e6) * 1000) + whole_day_s * 10**9 - (1 if whole_day_s else 0)
