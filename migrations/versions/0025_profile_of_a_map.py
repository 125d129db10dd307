"""A map has a profile; those that there are were described in the product's."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op
from alembic.util import CommandError

revision = "0025"
down_revision = "0024"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column."""
    op.add_column("maps", sa.Column("profile", sa.String(16), nullable=False, server_default="product"))


def downgrade() -> None:
    """Drop it; a map of another profile than the product's cannot be kept."""
    found = op.get_bind().execute(sa.text("SELECT count(*) FROM maps WHERE profile <> 'product'")).scalar_one()
    if found:
        raise CommandError(f"{found} maps are in the profile of the paper, which the older version does not know")
    op.drop_column("maps", "profile")
