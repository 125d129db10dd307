"""Bringing a database to the schema of this version."""

from __future__ import annotations

import sqlite3
from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory

from revisit.service.adapters.filesystem import require_local
from revisit.service.adapters.sql.unit_of_work import WriterLock

MIGRATIONS = Path(__file__).resolve().parents[3] / "migrations"


def migrate(database: Path, revision: str = "head") -> None:
    """Upgrade (or, to an older revision, downgrade) the SQLite file, which is made where it is missing.

    Raises StorageUncertain while another process writes; RemoteFileSystem where the file would not be on this machine.
    """
    require_local(database.parent)
    database.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    config = alembic_config(database)
    lock = WriterLock(database)
    try:
        with lock.held():
            if revision == "head" or current_revision(database) is None:
                command.upgrade(config, revision)
            else:
                command.downgrade(config, revision)
    finally:
        lock.close()


def alembic_config(database: Path) -> Config:
    """Alembic's configuration for the file, without an ini file."""
    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS))
    config.set_main_option("sqlalchemy.url", f"sqlite:///{database}")
    return config


def known_revisions() -> frozenset[str]:
    """The revisions that this version can open or upgrade."""
    scripts = ScriptDirectory(str(MIGRATIONS))
    return frozenset(script.revision for script in scripts.walk_revisions())


def newest_revision() -> str:
    """The revision that this version brings a database to."""
    return str(ScriptDirectory(str(MIGRATIONS)).get_current_head())


def current_revision(database: Path) -> str | None:
    """The revision a database is at, or None for an empty one."""
    if not database.exists():
        return None
    connection = sqlite3.connect(f"file:{database}?mode=ro", uri=True)
    try:
        row = connection.execute("SELECT version_num FROM alembic_version").fetchone()
    except sqlite3.OperationalError:
        return None
    finally:
        connection.close()
    return None if row is None else str(row[0])
