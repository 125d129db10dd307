"""The documentation is complete: every name a user can meet has its heading, and guides name what exists."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import pytest
import typer

from revisit.cli.app import app
from revisit.core.errors import ErrorCode
from revisit.core.verification import RejectionReason
from revisit.sdk.resources import LoopPolicy
from revisit.service.rest.app import create_app
from revisit.service.settings import Settings
from revisit.v1 import (
    ingest_pb2,
    loop_closure_pb2,
    map_pb2,
    mapping_pb2,
    operation_pb2,
    robot_pb2,
    session_pb2,
    submap_pb2,
    system_pb2,
)

ROOT = Path(__file__).resolve().parents[3]
DOCS = ROOT / "docs"
PROTOCOLS = (
    ingest_pb2, loop_closure_pb2, map_pb2, mapping_pb2, operation_pb2, robot_pb2, session_pb2, submap_pb2, system_pb2,
)  # fmt: skip


def commands_of(group, prefix="revisit"):
    """Whole name -> command, of every command under a group."""
    found = {}
    for name, command in group.commands.items():
        found[f"{prefix} {name}"] = command
        found |= commands_of(command, f"{prefix} {name}") if hasattr(command, "commands") else {}
    return found


COMMANDS = commands_of(typer.main.get_command(app))


def headings(page: str) -> set[str]:
    text = (DOCS / page).read_text()
    return {line.lstrip("#").strip() for line in text.splitlines() if line.startswith("#")}


def test_every_error_code_has_its_heading():
    assert {code.value for code in ErrorCode} <= headings("reference/errors.md")


def test_every_setting_has_its_heading():
    assert {f"REVISIT_{name.upper()}" for name in Settings.model_fields} <= headings("reference/settings.md")


def test_every_command_has_its_heading():
    assert len(COMMANDS) > 8
    assert COMMANDS.keys() <= headings("reference/cli.md")


def test_every_route_of_v1_and_every_probe_has_its_heading():
    document = create_app(None).openapi()
    routes = {f"{method.upper()} {path}" for path, methods in document["paths"].items() for method in methods}
    assert len(routes) > 25
    assert routes <= headings("reference/rest-and-grpc.md")


def test_every_rpc_has_its_heading():
    services = [service for module in PROTOCOLS for service in module.DESCRIPTOR.services_by_name.values()]
    calls = {f"{service.name}.{method.name}" for service in services for method in service.methods}
    assert len(calls) > 20
    assert calls <= headings("reference/rest-and-grpc.md")


def test_every_reason_for_a_rejection_is_explained():
    assert {reason.value for reason in RejectionReason} <= headings("how-to/why-a-loop-is-rejected.md")


def test_the_advice_for_a_rejection_names_rules_that_can_be_set_and_no_others():
    page = (DOCS / "how-to/read-an-answer.md").read_text()
    for rule in fields(LoopPolicy):
        assert f"| `{rule.name}` |" in page
    assert "`verification." not in page


def test_every_promise_names_tests_and_all_of_them_exist():
    rows = re.findall(r"^\| (P\d+) \|[^|]*\|([^|]*)\|", (DOCS / "reference/reliability.md").read_text(), re.MULTILINE)
    assert [promise for promise, _ in rows] == [f"P{number}" for number in range(1, 35)]
    named = {promise: re.findall(r"`([\w/]+(?:\.py|/))`", tests) for promise, tests in rows}
    assert [promise for promise, tests in named.items() if not tests] == []
    assert [test for tests in named.values() for test in tests if not has_tests(ROOT / "tests" / test)] == []


def has_tests(path: Path) -> bool:
    """Whether there is such a file, or folder of files, with tests in it."""
    files = path.rglob("test_*.py") if path.is_dir() else [path]
    return any(re.search(r"^(?:async )?def test_", file.read_text(), re.MULTILINE) for file in files if file.exists())


@pytest.mark.parametrize("page", sorted((DOCS / "how-to").glob("*.md")) + sorted((DOCS / "tutorial").glob("*.md")))
def test_every_option_in_a_guide_is_an_option_of_its_command(page):
    for line in re.findall(r"^(?:\$ )?(revisit .+)$", page.read_text(), re.MULTILINE):
        words = line.split("#")[0].split()
        command = COMMANDS.get(" ".join(words[:3])) or COMMANDS[" ".join(words[:2])]
        known = {option for parameter in command.params for option in [*parameter.opts, *parameter.secondary_opts]}
        assert {word.split("=")[0] for word in words if word.startswith("--")} <= known, line


def test_every_setting_in_a_guide_exists():
    clients = {"REVISIT_HTTP", "REVISIT_GRPC", "REVISIT_API_KEY", "REVISIT_CA"}
    clients |= {"REVISIT_CERTIFICATE", "REVISIT_CERTIFICATE_KEY", "REVISIT_DATA"}
    known = {f"REVISIT_{name.upper()}" for name in Settings.model_fields} | clients
    for page in [*(DOCS / "how-to").glob("*.md"), *(DOCS / "tutorial").glob("*.md"), ROOT / "README.md"]:
        assert set(re.findall(r"REVISIT_[A-Z_]+", page.read_text())) <= known, page.name
