"""Sessions have readings of radio, and submaps the fingerprints made of them."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0038"
down_revision = "0037"
branch_labels = None
depends_on = None

NUMBER = sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def upgrade() -> None:
    """Add a column and a table: of submaps that are there nobody has told any."""
    op.add_column("submaps", sa.Column("radio", sa.LargeBinary, nullable=True))
    op.create_table(
        "radio_readings",
        sa.Column("number", NUMBER, primary_key=True, autoincrement=True),
        *(sa.Column(name, sa.String(64), nullable=False) for name in ("tenant", "map_id", "session_id")),
        *(sa.Column(name, sa.BigInteger, nullable=False) for name in ("stamp_ns", "time_slice")),
        sa.Column("heard", sa.LargeBinary, nullable=False),
        sa.Column("checksum", sa.BigInteger, nullable=True),
        sa.ForeignKeyConstraint(
            ["tenant", "map_id", "session_id"],
            ["sessions.tenant", "sessions.map_id", "sessions.session_id"],
            name="fk_radio_readings_sessions_tenant_map_id_session_id",
        ),
        sa.UniqueConstraint(
            "tenant", "map_id", "session_id", "stamp_ns", name="uq_radio_readings_tenant_map_id_session_id_stamp_ns"
        ),
        sqlite_autoincrement=True,
    )
    op.create_index(
        "ix_radio_readings_tenant_map_id_session_id_time_slice",
        "radio_readings",
        ["tenant", "map_id", "session_id", "time_slice"],
    )


def downgrade() -> None:
    """Drop them: loops stay as they were judged with them."""
    op.drop_table("radio_readings")
    op.drop_column("submaps", "radio")
