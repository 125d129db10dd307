"""Bringing a PostgreSQL database to the schema of this version, while other versions may run on it.

A step says from which revision on a version runs beside it (`runs_from`; its own where it says nothing). The highest of
these is kept in the database. So an older version knows whether it may run on a schema that it has never heard of.
"""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING

from sqlalchemy import Connection, Engine, create_engine, inspect, text
from sqlalchemy.engine import URL
from sqlalchemy.exc import DBAPIError
from sqlalchemy.pool import NullPool

from revisit.service.domain.errors import StorageUncertain
from revisit.service.engines import schema
from revisit.service.engines.postgres.connections import CONNECTING, OLDEST
from revisit.service.engines.postgres.failures import LOCKED, sqlstate, translated
from revisit.service.engines.schema import ForeignSchema, UnusableServer

if TYPE_CHECKING:
    from alembic.config import Config

LOCK_S = 2
TRIES = 15
"""Each waits LOCK_S for another process that migrates, or holds a table: never longer, since others queue behind."""

PAUSE_S = 0.5

BY_CODE_POINT = ("C", "POSIX", "C.UTF-8", "C.utf8")
"""Collations that order text as Python does."""


def migrate(url: URL, revision: str = "head") -> None:
    """Upgrade (or, to an older revision, downgrade) the database, which must exist.

    Raises UnusableServer, ForeignSchema; StorageUncertain where it does not answer or is in use for too long.
    """
    engine = _engine(url)
    try:
        with translated():
            _patiently(engine, revision)
    finally:
        engine.dispose()


def current_revision(url: URL) -> str | None:
    """The revision of a database, or None for an empty one. Raises StorageUncertain where it does not answer."""
    engine = _engine(url)
    try:
        with translated(), engine.begin() as connection:
            return _revision(connection)
    finally:
        engine.dispose()


def require_fitting(url: URL) -> None:
    """Raises ForeignSchema where this version does not run on the schema that the database has."""
    engine = _engine(url)
    try:
        with translated(), engine.begin() as connection:
            present = _revision(connection)
            if present is None or not _runs_here(connection, present):
                newest = schema.NEWEST_REVISION
                raise ForeignSchema(f"it has schema {present}; `revisit serve` brings it to {newest}")
    finally:
        engine.dispose()


def _engine(url: URL) -> Engine:
    return create_engine(url, poolclass=NullPool, connect_args={**CONNECTING})


def _patiently(engine: Engine, revision: str) -> None:
    for _ in range(TRIES):
        try:
            with engine.begin() as connection:
                return _migrate(connection, revision)
        except DBAPIError as error:
            if sqlstate(error) not in LOCKED:
                raise
            time.sleep(PAUSE_S)
    raise StorageUncertain("other processes hold the tables of the database; nothing was migrated")


def _migrate(connection: Connection, revision: str) -> None:
    """Run the migrations in one transaction, as the only process that does so."""
    _require_usable(connection)
    connection.exec_driver_sql(f"SET LOCAL lock_timeout = '{LOCK_S}s'")
    connection.exec_driver_sql("SELECT pg_advisory_xact_lock(hashtext('revisit'), hashtext('migrate'))")
    present = _revision(connection)
    if revision == "head" and present is not None and _runs_here(connection, present):
        return
    from alembic import command
    from alembic.util import CommandError

    if present is not None and present not in schema.known_revisions():
        newest = schema.NEWEST_REVISION
        raise ForeignSchema(f"it was written by a newer Revisit (schema {present}, this one knows up to {newest})")
    upwards = revision == "head" or present is None
    try:
        (command.upgrade if upwards else command.downgrade)(_configuration(connection), revision)
    except CommandError as error:
        raise ForeignSchema(str(error)) from error


def _require_usable(connection: Connection) -> None:
    """Raises UnusableServer."""
    version = connection.dialect.server_version_info or (0,)
    if version < OLDEST:
        raise UnusableServer(f"the server is PostgreSQL {version[0]}, and at least {OLDEST[0]} is needed")
    query = "SELECT datlocprovider, datcollate, pg_encoding_to_char(encoding) FROM pg_database WHERE datname = "
    provider, collation, encoding = connection.exec_driver_sql(f"{query} current_database()").one()
    collation = {"b": "C", "i": "the rules of a language (ICU)"}.get(provider, collation)
    if collation not in BY_CODE_POINT or encoding != "UTF8":
        raise UnusableServer(
            f"the database is in {encoding} and orders text by {collation}. "
            "Make it with CREATE DATABASE ... TEMPLATE template0 ENCODING 'UTF8' LOCALE 'C'"
        )


def _revision(connection: Connection) -> str | None:
    if not inspect(connection).has_table("alembic_version"):
        return None
    return connection.exec_driver_sql("SELECT version_num FROM alembic_version").scalar()


def _runs_here(connection: Connection, present: str) -> bool:
    """Whether this version runs on the schema, its own or a newer one that older versions were left room in."""
    if present == schema.NEWEST_REVISION:
        return True
    oldest = connection.exec_driver_sql("SELECT oldest FROM schema_accepts").scalar()
    return present > schema.NEWEST_REVISION and oldest is not None and oldest <= schema.NEWEST_REVISION


def _keep_range(connection: Connection) -> None:
    """Note which versions may run on the schema as it is now."""
    present = _revision(connection)
    steps = [step for step in schema.scripts().walk_revisions() if present is not None and step.revision <= present]
    oldest = max((getattr(step.module, "runs_from", step.revision) for step in steps), default=None)
    connection.exec_driver_sql("CREATE TABLE IF NOT EXISTS schema_accepts (oldest VARCHAR(32) NOT NULL)")
    connection.exec_driver_sql("DELETE FROM schema_accepts")
    if oldest is not None:
        connection.execute(text("INSERT INTO schema_accepts VALUES (:oldest)"), {"oldest": oldest})


def _configuration(connection: Connection) -> Config:
    """Alembic's configuration, without an ini file."""
    from alembic.config import Config

    options = {"connection": connection, "transactional_ddl": True}
    config = Config(attributes={"options": options, "afterwards": partial(_keep_range, connection)})
    config.set_main_option("script_location", str(schema.MIGRATIONS))
    return config
