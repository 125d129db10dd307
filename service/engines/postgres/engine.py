"""PostgreSQL's implementation of `DatabaseEngine`."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from sqlalchemy import Connection, Table, func, select, text, update
from sqlalchemy.exc import IntegrityError

from revisit.service.engines.postgres.connections import BEGUN, NOW_MS

UNIQUE_VIOLATION = "23505"

_ALONE = text("SELECT pg_advisory_xact_lock(hashtext('revisit'), hashtext(:table))")
_HEIGHT = text("SELECT number FROM audit_height")
_NOW_MS = text(NOW_MS)

FRESH_S = 0.05
"""So old may the time be that a transaction got at its begin."""


def server_ms(connection: Connection) -> int:
    """The server's own clock, milliseconds: as the transaction began, where that was a moment ago."""
    begun = connection.info.get(BEGUN)
    if begun is not None and time.monotonic() - begun[1] < FRESH_S:
        return int(begun[0])
    return int(connection.execute(_NOW_MS).scalar_one())


class PostgresEngine:
    """`sql.engine.DatabaseEngine`. Write transactions of several processes run at the same time."""

    def __init__(self, now_ms: Callable[[Connection], int]) -> None:
        """`now_ms` tells the time of the store."""
        self._now_ms = now_ms

    def last_number(self, connection: Connection, table: Table) -> int:
        """See `DatabaseEngine`: a trigger keeps that of the audit log, and of other tables the newest row stays.

        Never that of a sequence, which is ahead of what is committed.
        """
        number = next(iter(table.primary_key.columns))
        newest = _HEIGHT if table.name == "audit_log" else select(func.max(number))
        return int(connection.execute(newest).scalar() or 0)

    def number_in_commit_order(self, connection: Connection, table: Table) -> None:
        """See `DatabaseEngine`."""
        connection.execute(_ALONE, {"table": table.name})

    def now_ms(self, connection: Connection) -> int:
        """See `DatabaseEngine`."""
        return self._now_ms(connection)

    def is_duplicate(self, error: IntegrityError) -> bool:
        """See `DatabaseEngine`."""
        return getattr(error.orig, "sqlstate", None) == UNIQUE_VIOLATION

    def any_text(self, connection: Connection) -> AbstractContextManager[None]:
        """See `DatabaseEngine`: the server hands out no text that is none."""
        return nullcontext()

    def overwrite(self, connection: Connection, table: Table, number: int, values: Mapping[str, Any]) -> None:
        """See `DatabaseEngine`."""
        connection.execute(update(table).where(table.c.number == number).values(**values))

    def damaged_rows(self, connection: Connection, table: Table, numbers: Sequence[int]) -> list[int]:
        """See `DatabaseEngine`: a damaged page is an error of its reader."""
        return []
