"""Bringing a SQLite file to the schema of this version."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import structlog
from sqlalchemy import Connection

from revisit.service.engines import schema
from revisit.service.engines.local.files.filesystem import require_local
from revisit.service.engines.local.sqlite.connections import writer_engine
from revisit.service.engines.local.sqlite.row_checksums import DamagedRow, damage, seal
from revisit.service.engines.local.sqlite.transactions import WriterLock
from revisit.service.engines.schema import ForeignSchema

if TYPE_CHECKING:  # imported where something is migrated
    from alembic.config import Config

_log = structlog.get_logger(__name__)

LAST_OF_ALL_STEPS = "74bcf880"
"""The last commit that has the steps from the first schema to 0024: nothing was released before."""


def migrate(database: Path, revision: str = "head") -> None:
    """Upgrade (or, to an older revision, downgrade) the SQLite file, which is made where it is missing.

    Raises ForeignSchema; StorageUncertain while another process writes; RemoteFileSystem where the file would not be on
    this machine.
    """
    require_local(database.parent)
    database.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    lock = WriterLock(database)
    try:
        with lock.held():
            _migrate(database, revision)
    finally:
        lock.close()


def current_revision(database: Path) -> str | None:
    """The revision a database is at, or None for an empty one. Raises sqlite3.DatabaseError for a damaged one."""
    if not database.exists():
        return None
    connection = sqlite3.connect(f"file:{database}?mode=ro", uri=True)
    try:
        row = connection.execute("SELECT version_num FROM alembic_version").fetchone()
    except sqlite3.OperationalError:
        return None
    except UnicodeError as error:  # of SQLite's message about a name that is none any more
        raise sqlite3.DatabaseError("the schema of the database is damaged") from error
    finally:
        connection.close()
    return None if row is None else str(row[0])


def _migrate(database: Path, revision: str) -> None:
    """Run the migrations on a writer's connection, in one transaction: SQLite can roll back changes of the schema."""
    present = current_revision(database)
    if revision == "head" and present == schema.NEWEST_REVISION:
        return
    from alembic import command
    from alembic.util import CommandError

    if present is not None and present not in schema.known_revisions():
        raise ForeignSchema(_way_from(present))
    upwards = revision == "head" or present is None
    engine = writer_engine(database, checkpoints=True, checksums=False)
    try:
        with engine.connect() as connection:
            damaged = damage(_driver(connection))
            if damaged:
                _log.error("rows_damaged", rows=[f"{one.table} {[*one.key.values()]}" for one in damaged[:20]])
            config = _configuration(connection, damaged)
            (command.upgrade if upwards else command.downgrade)(config, revision)
    except CommandError as error:
        raise ForeignSchema(str(error)) from error
    finally:
        engine.dispose()


def _way_from(present: str) -> str:
    """The advice for a database of an unknown revision."""
    newest, oldest = schema.NEWEST_REVISION, min(schema.known_revisions())
    if present > newest:
        return (
            f"it was written by a newer Revisit (schema {present}, this one knows up to {newest}). Start the newer "
            "version, or restore a backup of this one"
        )
    return (
        f"it was written by an older Revisit (schema {present}, this one begins with {oldest}). Start "
        f"the version of commit {LAST_OF_ALL_STEPS} on it once, which upgrades it, then this one"
    )


def _driver(connection: Connection) -> sqlite3.Connection:
    driver = connection.connection.driver_connection
    if not isinstance(driver, sqlite3.Connection):
        raise TypeError(f"the migrations run on {type(driver).__name__}, not on SQLite's own driver")
    return driver


def _seal(connection: Connection, damaged: Sequence[DamagedRow]) -> None:
    """Give all rows their checksums, in the transaction of the migrations; what was damaged before stays so."""
    seal(_driver(connection), damaged)


def _configuration(connection: Connection, damaged: Sequence[DamagedRow]) -> Config:
    """Alembic's configuration, without an ini file."""
    from alembic.config import Config

    # Batch mode: changes beyond SQLite's ALTER TABLE are made in a copy of the table.
    options = {"connection": connection, "render_as_batch": True, "transactional_ddl": True}
    config = Config(attributes={"options": options, "afterwards": partial(_seal, connection, damaged)})
    config.set_main_option("script_location", str(schema.MIGRATIONS))
    return config
