"""The scale of a map's scene, and the request and trace that a job came from."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the columns; maps that exist are of street size, jobs that exist have no known origin."""
    op.add_column("maps", sa.Column("scene_scale", sa.Float(), nullable=False, server_default="1.0"))
    op.add_column("jobs", sa.Column("request_id", sa.String(length=64), nullable=True))
    op.add_column("jobs", sa.Column("traceparent", sa.String(length=64), nullable=True))


def downgrade() -> None:
    """Drop the columns. A map of another scale would be read as one of street size: there must be none."""
    scaled = op.get_bind().scalar(sa.text("SELECT count(*) FROM maps WHERE scene_scale != 1.0"))
    if scaled:
        raise RuntimeError(f"{scaled} maps have a scene_scale that the older schema cannot hold; delete them first")
    op.drop_column("jobs", "traceparent")
    op.drop_column("jobs", "request_id")
    op.drop_column("maps", "scene_scale")
