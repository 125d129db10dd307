"""How Alembic reaches the database: the package of the engine gives it a connection, and says what comes afterwards."""

from __future__ import annotations

from alembic import context

from revisit.service.engines.sql.tables import metadata


def run() -> None:
    """Run the migrations that were asked for, in one transaction."""
    context.configure(target_metadata=metadata, **context.config.attributes["options"])
    with context.begin_transaction():
        context.run_migrations()
        context.config.attributes["afterwards"]()


run()
