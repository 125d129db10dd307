"""Connections to a PostgreSQL server: how a transaction begins for a writer, and how for a reader."""

from __future__ import annotations

import time
from importlib.util import find_spec

from pydantic_core import from_json
from sqlalchemy import Connection, Engine, create_engine, event, make_url
from sqlalchemy.engine import URL
from sqlalchemy.exc import ArgumentError

from revisit.service.engines.schema import UnusableServer

READERS = 2
"""Threads that read for the event loop. Other threads read for themselves, each with a connection of its own."""

MOST_READERS = 16
WATCHED = {"keepalives_idle": 5, "keepalives_interval": 2, "keepalives_count": 3, "tcp_user_timeout": 10_000}
"""A server whose host was cut off resets no connection: it is given up after about 10 s without any answer."""

CONNECTING = {"connect_timeout": 5, "application_name": "revisit", "client_encoding": "utf8", **WATCHED}
POOL_S = 5.0

NOW_MS = "SELECT CAST(extract(epoch FROM clock_timestamp()) * 1000 AS BIGINT)"
BEGUN = "begun at"
"""Under this name a writer's connection keeps the server's time as its transaction began, milliseconds, and its own
monotonic time, seconds: most transactions need no other, and it comes along with their first round trip."""

LOCK_MS = 2000
"""How long a writer waits for a row that another process holds, where it holds nothing of other members itself."""

TRANSACTION_S = 60
"""After this long the server ends a transaction: one that is forgotten would keep rows locked, and dead rows."""

IDLE_S = 10
"""After this long without a statement the server ends a writer's transaction: its process was stopped or cut off."""

TRANSACTION_TIMEOUT_FROM = (17,)
"""The version of PostgreSQL that can end a transaction for its length; those before end one that does nothing."""

OLDEST = (16,)
"""The oldest version of PostgreSQL that the service runs on."""


def server_url(text: str) -> URL:
    """The address of a database, as `postgresql://user:password@host:port/name`. Raises UnusableServer."""
    if find_spec("psycopg") is None:
        raise UnusableServer("REVISIT_DATABASE_URL needs the extra `cluster`: pip install 'revisit-loops[cluster]'")
    try:
        url = make_url(text)
    except ArgumentError as error:
        raise UnusableServer("REVISIT_DATABASE_URL is no address like postgresql://user@host/name") from error
    if url.drivername not in ("postgresql", "postgres", "postgresql+psycopg"):
        raise UnusableServer(f"REVISIT_DATABASE_URL begins with {url.drivername}://, and only postgresql:// is known")
    return url.set(drivername="postgresql+psycopg")


def writer_engine(url: URL) -> Engine:
    """An engine of one connection, whose transactions see what is committed before each statement.

    Each begins with a savepoint, `member`.
    """
    engine = _engine(url, pool_size=1, max_overflow=0)
    begin = f"{NOW_MS}; BEGIN; SET LOCAL lock_timeout = {LOCK_MS}"
    _begin_with(engine, begin, IDLE_S, then="SAVEPOINT member")
    return engine


def reader_engine(url: URL) -> Engine:
    """An engine for reading: its transactions see one snapshot and can change nothing."""
    engine = _engine(url, pool_size=READERS, max_overflow=MOST_READERS - READERS)
    _begin_with(engine, "BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY", TRANSACTION_S)
    return engine


def _engine(url: URL, *, pool_size: int, max_overflow: int) -> Engine:
    return create_engine(
        url,
        json_deserializer=from_json,
        pool_size=pool_size,
        max_overflow=max_overflow,
        pool_timeout=POOL_S,
        # Transactions are begun here, in one round trip with their limits.
        connect_args={"autocommit": True, **CONNECTING},
    )


def _begin_with(engine: Engine, begin: str, idle_s: int, *, then: str = "") -> None:
    """All limits are those of the transaction, so that a pooler between may hand on the session."""

    @event.listens_for(engine, "begin")
    def begin_transaction(connection: Connection) -> None:
        limits = f"SET LOCAL idle_in_transaction_session_timeout = '{idle_s}s'"
        if (connection.dialect.server_version_info or OLDEST) >= TRANSACTION_TIMEOUT_FROM:
            limits += f"; SET LOCAL transaction_timeout = '{TRANSACTION_S}s'"
        told = connection.exec_driver_sql(f"{begin}; {limits}; {then}")
        connection.info[BEGUN] = (int(told.scalar_one()), time.monotonic()) if told.returns_rows else None
