"""The steps of the schema, which all engines share: what this version is at, and what it knows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # imported where something is migrated: a worker only asks for the revision
    from alembic.script import ScriptDirectory

MIGRATIONS = Path(__file__).resolve().parents[2] / "migrations"

NEWEST_REVISION = max(step.name[:4] for step in (MIGRATIONS / "versions").glob("[0-9]*.py"))
"""The schema of this version: the head of `migrations`. A start that finds it has nothing to read there."""


class ForeignSchema(Exception):
    """The database is of a version that this one does not know."""


class UnusableServer(Exception):
    """The address of a database server is none, or the server or database does not do for the service."""


def known_revisions() -> frozenset[str]:
    """The revisions that this version can open or upgrade."""
    return frozenset(script.revision for script in scripts().walk_revisions())


def scripts() -> ScriptDirectory:
    """All steps. Imports Alembic."""
    from alembic.script import ScriptDirectory

    return ScriptDirectory(str(MIGRATIONS))
