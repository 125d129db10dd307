"""SQLite's implementation of `DatabaseEngine`."""

from __future__ import annotations

from sqlalchemy import Connection, Table, text
from sqlalchemy.exc import IntegrityError

from revisit.service.engines.local.sqlite.store_clock import StoreClock

_LAST_NUMBER = text("SELECT seq FROM sqlite_sequence WHERE name = :table")


class SqliteEngine:
    """`sql.engine.DatabaseEngine`. One write transaction runs at a time, which makes it serialisable."""

    def __init__(self, clock: StoreClock) -> None:
        """`clock` is that of the store."""
        self._clock = clock

    def last_number(self, connection: Connection, table: Table) -> int:
        """See `DatabaseEngine`: SQLite keeps the highest AUTOINCREMENT number apart from the rows."""
        return int(connection.execute(_LAST_NUMBER, {"table": table.name}).scalar() or 0)

    def number_in_commit_order(self, connection: Connection, table: Table) -> None:
        """See `DatabaseEngine`: a write transaction runs alone, so there is nothing to do."""

    def now_ms(self, connection: Connection) -> int:
        """See `DatabaseEngine`."""
        return self._clock.now_ms(connection)

    def is_duplicate(self, error: IntegrityError) -> bool:
        """See `DatabaseEngine`."""
        return "UNIQUE" in str(error.orig)
