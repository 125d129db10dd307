"""The storey of a session comes and goes with its migration, on a database that is in use."""

from __future__ import annotations

import asyncio

import pytest

from revisit.service.adapters.sqlite.migration import current_revision, migrate
from revisit.service.application.catalogue.sessions import CreateSession
from tests.support.service_world import SESSION, TENANT, open_session, sqlite_world
from tests.support.stored_rows import columns, run


@pytest.fixture
def database(tmp_path):
    """A store of the revision before, with the session maps/town/sessions/monday."""
    world = sqlite_world(tmp_path)
    asyncio.run(open_session(world))
    world.context.transactions.close()
    migrate(tmp_path / "revisit.db", "0018")
    return tmp_path / "revisit.db"


def test_of_sessions_of_before_nobody_has_said_the_storey_and_they_are_created_again_as_then(database, tmp_path):
    assert "storey" not in columns(database, "sessions")
    world = sqlite_world(tmp_path)
    again = asyncio.run(world.use_cases.sessions.create(TENANT, CreateSession(SESSION.map_id, SESSION.session_id)))
    world.context.transactions.close()
    assert (again.replay, again.session.storey) == (True, None)


def test_a_session_with_a_storey_is_not_compared_with_all_by_going_back(database):
    migrate(database)
    run(database, "UPDATE sessions SET storey = 'B2'")
    with pytest.raises(RuntimeError, match="1 sessions have a storey"):
        migrate(database, "0018")
    assert run(database, "SELECT storey FROM sessions") == [("B2",)]
    run(database, "UPDATE sessions SET storey = NULL")
    migrate(database, "0018")
    assert current_revision(database) == "0018"
