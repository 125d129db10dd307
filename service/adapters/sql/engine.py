"""What the statements of this package need from the database that runs them, where standard SQL says nothing."""

from __future__ import annotations

from typing import Protocol

from sqlalchemy import Connection, Table
from sqlalchemy.exc import IntegrityError


class DatabaseEngine(Protocol):
    """A database engine, as the repositories see it.

    The package of an engine also implements `ports.Transactions`, and its transactions keep three promises that the
    repositories rely on. A write transaction is serialisable: what it has read does not change before it commits. Text
    is ordered by code point, as Python orders it. A refused statement (IntegrityError) is passed on to the caller, who
    ends the transaction, or the savepoint that the work has for itself.
    """

    def last_number(self, connection: Connection, table: Table) -> int:
        """The highest number that a row of `table` was ever given, whether or not it is still there; 0 for none."""
        ...

    def number_in_commit_order(self, connection: Connection, table: Table) -> None:
        """From here to its commit, let this transaction alone give numbers to new rows of `table`.

        A reader that has seen a number then never misses a lower one that is committed later.
        """
        ...

    def is_duplicate(self, error: IntegrityError) -> bool:
        """Whether a row was refused because its unique key is taken, and not because its parent is missing."""
        ...
