"""Ports are small, and each state is written once."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from revisit.service.application.contract import states

ROOT = Path(__file__).resolve().parents[2]
CONTRACT = ROOT / "service" / "application" / "contract"
MOST_METHODS = 5
REASONED = {"UnitOfWork": "Twenty-three properties and no methods"}
"""Larger ports, and how their docstring begins to say why."""


def ports() -> list[ast.ClassDef]:
    trees = [ast.parse(path.read_text()) for path in sorted(CONTRACT.glob("*.py"))]
    classes = [node for tree in trees for node in tree.body if isinstance(node, ast.ClassDef)]
    return [node for node in classes if any("Protocol" in ast.unparse(parent) for parent in node.bases)]


@pytest.mark.parametrize("port", ports(), ids=lambda port: port.name)
def test_a_port_has_at_most_five_methods_or_a_reason(port):
    methods = [node for node in port.body if isinstance(node, ast.FunctionDef)]
    reason = REASONED.get(port.name)
    assert len(methods) <= MOST_METHODS if reason is None else reason in (ast.get_docstring(port) or "")


def test_there_are_ports_to_look_at():
    assert len(ports()) > 15


@pytest.mark.parametrize("folder", ["application", "adapters", "rest", "grpc", "wire", "worker"])
def test_the_states_of_jobs_and_resources_are_written_in_one_place(folder):
    enums = [enum for enum in vars(states).values() if isinstance(enum, type) and enum.__module__ == states.__name__]
    values = {member.value for enum in enums for member in enum}
    found = {
        f"{path.relative_to(ROOT)}: {node.value}"
        for path in (ROOT / "service" / folder).rglob("*.py")
        if path != CONTRACT / "states.py"
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Constant) and node.value in values
    }
    # The log of the index names its own kinds of changes.
    assert {entry for entry in found if "change_log" not in entry} == set()
