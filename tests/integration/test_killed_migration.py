"""A migration that is killed at any of its statements is finished by the next start; a newer database is left alone."""

from __future__ import annotations

import os
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from revisit.service.engines.local.sqlite.migration import LAST_OF_ALL_STEPS, migrate
from revisit.service.engines.schema import MIGRATIONS, NEWEST_REVISION
from tests.support.campaigns import Campaign
from tests.support.next_migration import NEXT_REVISION, migrations_with_a_next_step
from tests.support.processes import ROOT

EVERY = int(os.environ.get("REVISIT_TEST_MIGRATION_EVERY", "7"))
"""Every how many statements one attempt is killed in `make test`; the slow test kills at each."""

KILL_AND_RECOVER = """
import os, shutil, signal, sys
from pathlib import Path
from sqlalchemy import event
from sqlalchemy.engine import Engine
from revisit.service.engines import schema
from revisit.service.engines.local.sqlite import migration

old, home, every = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
schema.MIGRATIONS, schema.NEWEST_REVISION = Path(sys.argv[4]), sys.argv[5]

def in_child(database, kill_at):
    child = os.fork()
    if child == 0:
        seen = []
        @event.listens_for(Engine, "before_cursor_execute")
        def count(*_):
            seen.append(1)
            if len(seen) == kill_at:
                os.kill(os.getpid(), signal.SIGKILL)
        migration.migrate(database)
        os._exit(0)
    return os.waitpid(child, 0)[1]

statement = 1
while True:
    database = home / f"{statement}.db"
    if old.exists():
        shutil.copy(old, database)
    if in_child(database, statement) != signal.SIGKILL:
        break
    assert in_child(database, 0) == 0, f"no recovery after statement {statement}"
    statement += every
print(statement)
"""


def content(database: Path) -> list[tuple]:
    """The schema, its revision and every row of the maps."""
    connection = sqlite3.connect(database)
    try:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        made = connection.execute("SELECT type, name, sql FROM sqlite_master ORDER BY 1, 2").fetchall()
        revision = connection.execute("SELECT version_num FROM alembic_version").fetchall()
        return [*made, *revision, *connection.execute("SELECT * FROM maps ORDER BY number")]
    finally:
        connection.close()


def filled(database: Path) -> None:
    migrate(database)
    connection = sqlite3.connect(database)
    row = "INSERT INTO maps (tenant, map_id, content_hash, display_name, created_at_ns) VALUES ('t', ?, 'h', '', 7)"
    connection.executemany(row, [(f"m{number}",) for number in range(50)])
    connection.commit()
    connection.close()


def check_every(old: Path, home: Path, every: int) -> int:
    """Kill an upgrade of `old` (a new database where there is none) at each `every`-th statement; the last of them."""
    home.mkdir()
    migrations = migrations_with_a_next_step(home) if old.exists() else MIGRATIONS
    newest = NEXT_REVISION if old.exists() else NEWEST_REVISION
    command = [sys.executable, "-c", KILL_AND_RECOVER, str(old), str(home), str(every), str(migrations), newest]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=500, check=False)
    assert ran.returncode == 0, ran.stderr[-2000:]
    undisturbed = home / f"{int(ran.stdout)}.db"
    wrong = [database.name for database in sorted(home.glob("*.db")) if content(database) != content(undisturbed)]
    assert wrong == []
    return int(ran.stdout)


def test_a_new_database_killed_while_it_is_made_is_finished_by_the_next_start(tmp_path):
    assert check_every(tmp_path / "none.db", tmp_path / "killed", 3 * EVERY) > 20, "there are more statements than that"


def test_an_upgrade_of_a_filled_database_killed_at_any_statement_keeps_all_rows(tmp_path):
    filled(tmp_path / "old.db")
    assert check_every(tmp_path / "old.db", tmp_path / "killed", EVERY) > 10, "there are more statements than that"
    assert [row[-1] for row in content(tmp_path / "killed" / "1.db") if "m49" in row] == ["red"]


@pytest.mark.slow
@pytest.mark.parametrize("upgrade", [False, True], ids=["new", "filled"])
def test_a_migration_killed_at_each_of_its_statements_is_finished(tmp_path, upgrade):
    if upgrade:
        filled(tmp_path / "old.db")
    campaign, statements = Campaign("P27", 1), 0
    for _ in campaign:
        statements = check_every(tmp_path / "old.db", tmp_path / "killed", 1) - 1
    assert statements > (15 if upgrade else 40), "there are more statements than that"
    of_what = "an upgrade of a filled database" if upgrade else "a new database"
    campaign.publish(f"{of_what}: killed at each of {statements} statements, finished by the next start, no row lost")


@pytest.mark.parametrize(("revision", "way"), [("9999", "Start the newer version"), ("0006", LAST_OF_ALL_STEPS)])
def test_a_database_of_another_version_is_refused_with_the_way_and_left_alone(tmp_path, revision, way):
    migrate(tmp_path / "revisit.db")
    connection = sqlite3.connect(tmp_path / "revisit.db")
    connection.execute("UPDATE alembic_version SET version_num = ?", (revision,))
    connection.commit()
    connection.close()
    before = content(tmp_path / "revisit.db")
    environment = {**os.environ, "REVISIT_HOME": str(tmp_path), "REVISIT_HTTP_PORT": "0", "REVISIT_GRPC_PORT": "0"}
    command = [sys.executable, "-m", "revisit.service", "serve"]
    ended = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 78
    assert "does not fit this version" in ended.stderr
    assert revision in ended.stderr and way in ended.stderr
    assert content(tmp_path / "revisit.db") == before
