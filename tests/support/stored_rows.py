"""Rows of a database as any other program would read and write them, beside the schema that the service knows."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path


def run(database: Path, statement: str) -> list[tuple]:
    """Run one statement and commit it; its rows."""
    with closing(sqlite3.connect(database)) as connection:
        rows = connection.execute(statement).fetchall()
        connection.commit()
        return rows


def columns(database: Path, table: str) -> set[str]:
    """The names of the columns of a table."""
    return {row[1] for row in run(database, f"PRAGMA table_info({table})")}
