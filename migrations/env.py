"""How Alembic reaches the database: the writer engine of the service, in one transaction per migration."""

from __future__ import annotations

from pathlib import Path

from alembic import context
from sqlalchemy.engine import make_url

from revisit.service.adapters.sql.tables import metadata
from revisit.service.adapters.sql.unit_of_work import writer_engine


def run() -> None:
    """Run the migrations that were asked for."""
    url = make_url(context.config.get_main_option("sqlalchemy.url") or "")
    engine = writer_engine(Path(url.database or ""), checkpoints=True)
    with engine.connect() as connection:
        context.configure(connection=connection, target_metadata=metadata, render_as_batch=True, transactional_ddl=True)
        with context.begin_transaction():
            context.run_migrations()
    engine.dispose()


run()
