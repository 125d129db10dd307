"""How many files a change of the interface touches: made in a copy of the tree, and used there on both transports."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.patience import PATIENCE_S
from tests.support.source_copies import copied_tree

ROOT = Path(__file__).resolve().parents[2]

PROTO, RECORDS = "proto/revisit/v1/session.proto", "service/domain/records.py"
FIELD = {
    PROTO: [
        (r"(  string drift = 13;\n)", r"\1  // Who drove, in the client's words.\n  string driver = 14;\n"),
        (r"(message CreateSessionRequest {.*?  string drift = 5;\n)", r"\1  string driver = 6;\n"),
    ],
    RECORDS: [
        (r"(class SessionDetails:.*?    drift: str \| None = None\n)", r"\1    driver: str | None = None\n"),
        (r"(class SessionRecord:.*?    drift: str \| None = None\n)", r"\1    driver: str | None = None\n"),
    ],
}  # fmt: skip
"""A new detail of a session, `driver`; beside these files, one new migration."""

MIGRATION = """
import sqlalchemy as sa
from alembic import op

revision = "{next}"
down_revision = "{last}"
branch_labels = depends_on = None


def upgrade():
    op.add_column("sessions", sa.Column("driver", sa.String(64), nullable=True))


def downgrade():
    op.drop_column("sessions", "driver")
"""

RPC = """  // Count the sessions of a map.
  rpc CountSessions(CountSessionsRequest) returns (CountSessionsResponse);
"""
MESSAGES = """
message CountSessionsRequest {
  string parent = 1;
}

message CountSessionsResponse {
  uint32 sessions = 1;
}
"""
FUNCTION = """async def count_sessions(cases, tenant, request):
    view = await cases.maps.get(tenant, names.map_id(request.parent, "parent"))
    return {"sessions": view.session_count}


"""

CALL = {
    PROTO: [
        (r"(service SessionService {\n)", r"\1" + RPC),
        (r"\Z", MESSAGES),
    ],
    "revisit/api/calls.py": [
        (r'(        Row\("FinishSession")',
         r'        Row("CountSessions", READ, "GET /v1/{parent=maps/*}/sessions:count"),\n\1'),
    ],
    "service/calls/catalogue.py": [
        (r"(async def create_session\()", FUNCTION + r"\1"),
    ],
}  # fmt: skip
"""A new call, CountSessions."""

IN_THE_COPY = """
import tempfile
from pathlib import Path
from revisit import Client
from tests.support.live_service import live_service
from tests.support.service_world import sqlite_world

found = []
with tempfile.TemporaryDirectory() as home:
    world = sqlite_world(Path(home))
    with live_service(world) as service, Client(service.http) as rest, Client.grpc(service.grpc) as grpc:
        rest.create_map("town")
        for client in (rest, grpc):
            {use}
    world.context.transactions.close()
Path("found").write_text(chr(10).join(found))
"""
USE_OF_FIELD = """
            name = f"by-{type(client._transport).__name__}"
            made = client.create_session("town", name, driver="Ada")
            listed = [one.driver for one in client.list_sessions("town")]
            found.append(f"{made.driver} {client.get_session(made.name).driver} {listed}")
"""
USE_OF_CALL = """
            client.create_session("town", f"by-{type(client._transport).__name__}")
            found.append(str(client.call("CountSessions", parent="maps/town").sessions))
"""


def changed(tree: Path, changes: dict[str, list[tuple[str, str]]]) -> None:
    """Make the changes to hand-written files, then the stubs and the resources of the SDK from the proto files."""
    for name, edits in changes.items():
        text = (tree / name).read_text()
        for pattern, put in edits:
            text, count = re.subn(pattern, put, text, count=1, flags=re.DOTALL)
            assert count == 1, f"{name} has no place for {put!r}"
        (tree / name).write_text(text)
    for generated in ("proto", "resources"):
        python(tree, "scripts/generated_files.py", "write", generated)


def used(tree: Path, use: str) -> list[str]:
    """What a service and two clients of the copy find."""
    python(tree, "-c", IN_THE_COPY.format(use=use.strip()))
    return (tree / "found").read_text().splitlines()


def python(tree: Path, *arguments: str) -> None:
    environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        (sys.executable, *arguments), cwd=tree, env=environment, capture_output=True, text=True, check=False,
        timeout=2 * PATIENCE_S,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]


@pytest.mark.slow
def test_a_new_field_of_a_session_touches_three_hand_written_files(tmp_path):
    copied_tree(ROOT, tmp_path)
    last = sorted(path.stem[:4] for path in (tmp_path / "migrations/versions").glob("0*.py"))[-1]
    following = f"{int(last) + 1:04d}"
    migration = f"migrations/versions/{following}_driver.py"
    (tmp_path / migration).write_text(MIGRATION.format(next=following, last=last))
    changed(tmp_path, FIELD)
    assert len({*FIELD, migration}) == 3
    assert used(tmp_path, USE_OF_FIELD) == ["Ada Ada ['Ada']", "Ada Ada ['Ada', 'Ada']"]


@pytest.mark.slow
def test_a_new_call_touches_three_hand_written_files(tmp_path):
    copied_tree(ROOT, tmp_path)
    changed(tmp_path, CALL)
    assert len(CALL) == 3
    assert used(tmp_path, USE_OF_CALL) == ["1", "2"]


def test_every_call_is_one_use_case_or_a_function_of_its_name_and_every_function_is_a_call():
    from revisit.api.calls import CALLS, Cost
    from revisit.service.calls.plain import USES
    from revisit.service.calls.uses import ROOMS

    assert USES.keys() < CALLS.keys()
    answered = {one.use for one in CALLS.values() if one.row.cost is not Cost.SCANS and one.name not in USES}
    functions = {name for room in ROOMS for name, value in vars(room).items() if is_use(room, value)}
    assert functions == answered


def is_use(room, value) -> bool:
    """Whether a name of a module is a function of it that answers a call."""
    own = getattr(value, "__module__", "") == room.__name__
    return own and value.__code__.co_varnames[:2] == ("cases", "tenant") and not value.__name__.startswith("_")
