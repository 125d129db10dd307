"""Generated files that are committed are what their generators write now; the protocol is lint-clean."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
GROUPS = ROOT / "revisit/sdk/groups"


@pytest.mark.parametrize("name", ["proto", "openapi", "parameters", "references", "async", "decisions"])
def test_a_generated_file_is_up_to_date(name):
    # In a process of its own: what other tests import and change must not be written.
    command = [sys.executable, "scripts/generated_files.py", "check", name]
    checked = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_the_proto_files_are_lint_clean():
    buf = Path(sys.executable).parent / "buf"
    result = subprocess.run([buf, "lint", "proto"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout) == (0, "")


def test_the_types_of_the_asynchronous_client_can_be_read_and_hold_its_groups():
    stub = ast.parse((ROOT / "revisit/sdk/async_client.pyi").read_text())
    named = {one.name for one in stub.body if isinstance(one, ast.ClassDef)}
    groups = re.findall(r"^class (\w+)\(Group\):", "\n".join(map(Path.read_text, GROUPS.glob("*.py"))), re.MULTILINE)
    assert named == {*groups, "AsyncClient", "AwaitedStream", "AwaitedConversation"}
