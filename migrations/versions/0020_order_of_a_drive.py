"""The submaps of a session in the order of its drive."""

from __future__ import annotations

from alembic import op

revision = "0020"
down_revision = "0019"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Make them quick to find."""
    op.create_index(
        "ix_submaps_tenant_session_number_ordinal", "submaps", ["tenant", "session_number", "ordinal"]
    )


def downgrade() -> None:
    """Leave them to a look through the session."""
    op.drop_index("ix_submaps_tenant_session_number_ordinal", "submaps")
