"""Needs of this package's statements beyond standard SQL, answered by each database."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol

from sqlalchemy import Connection, Table
from sqlalchemy.exc import IntegrityError


class DatabaseEngine(Protocol):
    """A database engine, as the repositories see it.

    The package of an engine also implements `Transactions` and brings the schema up to date. The repositories rely on
    it for four things. Others do not change the records that a write transaction holds before it commits, and each
    statement sees what was committed before it. A number that a table has given to a row is never given to another,
    even where the row is gone. Text is ordered by code point, as Python orders it. A statement that is refused
    (IntegrityError) ends the work that sent it.
    """

    def last_number(self, connection: Connection, table: Table) -> int:
        """The highest number that a row of `table` was ever given, whether or not it is still there; 0 for none."""
        ...

    def number_in_commit_order(self, connection: Connection, table: Table) -> None:
        """From here to its commit, let this transaction alone give numbers to new rows of `table`.

        A reader that has seen a number then never misses a lower one that is committed later.
        """
        ...

    def now_ms(self, connection: Connection) -> int:
        """Milliseconds of the store's own clock, the same for all who use the store; no host's clock moves it."""
        ...

    def is_duplicate(self, error: IntegrityError) -> bool:
        """Whether a row was refused because its unique key is taken, and not because its parent is missing."""
        ...

    def any_text(self, connection: Connection) -> AbstractContextManager[None]:
        """Within the block a damaged text is read as bytes, so that the rows beside it can be read."""
        ...

    def overwrite(self, connection: Connection, table: Table, number: int, values: Mapping[str, Any]) -> None:
        """Change a damaged row, whatever is in it; it stays known as damaged."""
        ...

    def damaged_rows(self, connection: Connection, table: Table, numbers: Sequence[int]) -> list[int]:
        """Those of these rows that are not as they were written; none where the server itself looks at each reading."""
        ...
