"""PostgreSQL's implementation of `DatabaseEngine`."""

from __future__ import annotations

from sqlalchemy import Connection, Table, func, select, text
from sqlalchemy.exc import IntegrityError

UNIQUE_VIOLATION = "23505"

_ALONE = text("SELECT pg_advisory_xact_lock(hashtext('revisit'), hashtext(:table))")
_HEIGHT = text("SELECT number FROM audit_height")


class PostgresEngine:
    """`sql.engine.DatabaseEngine`. Write transactions of several processes run at the same time."""

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

    def is_duplicate(self, error: IntegrityError) -> bool:
        """See `DatabaseEngine`."""
        return getattr(error.orig, "sqlstate", None) == UNIQUE_VIOLATION
