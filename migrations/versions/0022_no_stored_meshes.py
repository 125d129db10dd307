"""Meshes are made when they are asked for, so no submap names one any more. Poses and evidence are packed from now on.

The rows of before keep their JSON, which is read as it is.
"""

from __future__ import annotations

import json
from typing import Any

import sqlalchemy as sa
from alembic import op

from revisit.service.adapters.sql.packed_columns import PackedEvidence, PackedPose

revision = "0022"
down_revision = "0021"
branch_labels = None
depends_on = None

POSE, EVIDENCE = PackedPose(), PackedEvidence()

PACKED: tuple[tuple[str, str, PackedPose | PackedEvidence, bool], ...] = (
    ("scans", "T_odom_sensor", POSE, False),
    ("submaps", "T_odom_submap", POSE, False),
    ("loop_closures", "T_match_query", POSE, True),
    ("loop_closures", "evidence", EVIDENCE, False),
    ("loop_events", "T_match_query", POSE, True),
    ("loop_events", "details", EVIDENCE, False),
    ("session_poses", "T_map_odom", POSE, False),
    ("early_corrections", "T_map_odom", POSE, False),
)
"""Table, column, how it is packed, and whether it may be empty."""

NEW = "in_its_place"


def upgrade() -> None:
    """Drop the names of the stored meshes: no row names them then, and the next sweep deletes them."""
    op.drop_index("ix_submaps_tenant_mesh_sha256", "submaps")
    op.drop_column("submaps", "mesh_sha256")
    for table, column, _, nullable in PACKED:
        op.add_column(table, sa.Column(NEW, sa.LargeBinary(), nullable=nullable, server_default=_default(nullable)))
        op.execute(f'UPDATE {table} SET {NEW} = CAST("{column}" AS BLOB)')
        _take_the_place(table, column)


def downgrade() -> None:
    """Write what is packed as JSON again, and add the column of meshes, empty: the older version calls them lost."""
    for table, column, packed, nullable in PACKED:
        op.add_column(table, sa.Column(NEW, sa.JSON(), nullable=nullable, server_default=_default(nullable)))
        _write_as_json(table, column, packed)
        _take_the_place(table, column)
    op.add_column("submaps", sa.Column("mesh_sha256", sa.String(64), nullable=True))
    op.create_index("ix_submaps_tenant_mesh_sha256", "submaps", ["tenant", "mesh_sha256"])


def _default(nullable: bool) -> sa.TextClause | None:
    """What an added column holds that may not be empty, until it is filled."""
    return None if nullable else sa.text("''")


def _take_the_place(table: str, column: str) -> None:
    op.drop_column(table, column)
    op.execute(f'ALTER TABLE {table} RENAME COLUMN {NEW} TO "{column}"')


def _write_as_json(table: str, column: str, packed: PackedPose | PackedEvidence) -> None:
    """Fill the new column of each row that has a value."""
    rows = sa.table(table, sa.column("number"), sa.column(column, packed), sa.column(NEW, sa.Text()))
    known = op.get_bind().execute(sa.select(rows.c.number, rows.c[column]).where(rows.c[column].is_not(None)))
    found: list[dict[str, Any]] = [{"row": number, "value": json.dumps(value)} for number, value in known]
    if found:
        change = sa.update(rows).where(rows.c.number == sa.bindparam("row")).values({NEW: sa.bindparam("value")})
        op.get_bind().execute(change, found)
