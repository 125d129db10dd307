"""SQLite's implementation of `DatabaseEngine`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

import sqlalchemy
from sqlalchemy import BigInteger, Connection, Table, func, text, update
from sqlalchemy.exc import IntegrityError

from revisit.service.engines.local.sqlite.row_checksums import COLUMN, any_text, is_whole
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

    def any_text(self, connection: Connection) -> AbstractContextManager[None]:
        """See `DatabaseEngine`."""
        driver: Any = connection.connection.driver_connection
        return any_text(driver)

    def overwrite(self, connection: Connection, table: Table, number: int, values: Mapping[str, Any]) -> None:
        """See `DatabaseEngine`. Where a statement changes the checksum, no trigger reads the row, which may hold a text
        that no function can be given.
        """
        columns = (sqlalchemy.column(one.name, one.type) for one in table.columns if one.name != COLUMN)
        bare = sqlalchemy.table(table.name, *columns, sqlalchemy.column(COLUMN, BigInteger))
        other = func.coalesce(bare.c[COLUMN], 0).bitwise_not()
        connection.execute(update(bare).where(bare.c.number == number).values({**values, COLUMN: other}))

    def damaged_rows(self, connection: Connection, table: Table, numbers: Sequence[int]) -> list[int]:
        """See `DatabaseEngine`."""
        with self.any_text(connection):
            return [number for number in numbers if not self._is_whole(connection, table, number)]

    def _is_whole(self, connection: Connection, table: Table, number: int) -> bool:
        row = connection.exec_driver_sql(f'SELECT * FROM "{table.name}" WHERE number = ?', (number,)).one_or_none()  # noqa: S608
        return row is None or is_whole(table.name, row._asdict())
