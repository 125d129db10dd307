"""A new database of today's schema, made by the migrations once in a test process and copied from then on."""

from __future__ import annotations

import functools
import shutil
import tempfile
from pathlib import Path

from revisit.service.engines.local.sqlite.migration import migrate


def made_database(database: Path) -> Path:
    """The file `database`, with its folder; one that is there already is brought to today's schema."""
    database.parent.mkdir(parents=True, exist_ok=True)
    if database.exists():
        migrate(database)
    else:
        shutil.copyfile(_template(), database)
    return database


@functools.cache
def _template() -> Path:
    folder = tempfile.TemporaryDirectory(prefix="revisit-template-")
    _kept.append(folder)
    migrate(Path(folder.name) / "revisit.db")
    return Path(folder.name) / "revisit.db"


_kept: list[tempfile.TemporaryDirectory[str]] = []
"""Removed when the process ends."""
