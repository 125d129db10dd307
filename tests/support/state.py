"""Where services of tests keep their state: SQLite in their home, or a PostgreSQL that REVISIT_TEST_STATE asks for."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from sqlalchemy.engine import URL

ON_POSTGRES = os.environ.get("REVISIT_TEST_STATE") == "postgres"
"""Whether all services keep their state in PostgreSQL, so that a suite shows that it holds there."""


def of_sqlite(reason: str) -> pytest.MarkDecorator:
    """Marks tests whose subject is the file of SQLite; `reason` says why they have no form for a server."""
    return pytest.mark.skipif(ON_POSTGRES, reason=f"of SQLite: {reason}")


def database_of(home: Path) -> URL:
    """The database of a `home` on the server of this test process, made where there is none.

    A file names it, so that processes which tests start find it.
    """
    from revisit.service.engines.postgres.connections import server_url

    named = home / "database"
    if not named.exists():
        from tests.support.postgres import shared_server

        home.mkdir(parents=True, exist_ok=True)
        named.write_text(shared_server().made_database().render_as_string(hide_password=False))
    return server_url(named.read_text())
