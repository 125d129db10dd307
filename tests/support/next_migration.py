"""The migrations with one step more than there is: an upgrade of a store of today, for tests of upgrades."""

from __future__ import annotations

import shutil
from pathlib import Path

from revisit.service.engines.schema import MIGRATIONS, NEWEST_REVISION

NEXT_REVISION = f"{int(NEWEST_REVISION) + 1:04d}"

STEP = f'''
import sqlalchemy as sa
from alembic import op

revision = "{NEXT_REVISION}"
down_revision = "{NEWEST_REVISION}"
branch_labels = depends_on = None
TABLES = ("maps", "sessions", "scans", "submaps", "loop_closures")


def upgrade():
    for table in TABLES:
        op.add_column(table, sa.Column("colour", sa.String(16), nullable=True))
        op.execute(f"UPDATE {{table}} SET colour = 'red'")
        op.create_index(f"ix_{{table}}_colour", table, ["colour"])


def downgrade():
    for table in TABLES:
        op.drop_index(f"ix_{{table}}_colour", table)
        op.drop_column(table, "colour")
'''


def add_next_step(migrations: Path) -> Path:
    """Add it to a folder of migrations; its file."""
    step = migrations / "versions" / f"{NEXT_REVISION}_next_step.py"
    step.write_text(STEP)
    return step


def migrations_with_a_next_step(folder: Path) -> Path:
    """A folder of them beside `folder`'s other files."""
    made = folder / "migrations"
    shutil.copytree(MIGRATIONS, made, ignore=shutil.ignore_patterns("__pycache__"))
    add_next_step(made)
    return made
