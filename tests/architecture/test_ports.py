"""Ports are small, inherited members included, and each state is written once."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
from pathlib import Path
from typing import Any

import pytest

from revisit.service import ports as packaged
from revisit.service.domain import states

ROOT = Path(__file__).resolve().parents[2]
MOST_MEMBERS = 6
LARGER = {
    "UnitOfWork": 29,  # one property for each kind of record, and `everything`; no method
    "Repository": 16,  # any kind of record
    "SubmapRepository": 25,  # nine reads that are no list of rows, each of one or two features
    "JobRepository": 19,
    "ScanRepository": 21,
    "PlanRepository": 17,
    "LoopRepository": 21,
    "WebhookRepository": 19,
    "AwaitedJobs": 17,
    "JobQueue": 14,  # four smaller ports by their user: worker, supervisor, progress, drives in turn
    "VectorIndex": 11,
    "PlaceRecogniser": 7,
    "BlobStore": 7,
}
"""The members of each large port, exactly. An adapter has to write all of them: a number here grows only with a reason.

A feature is given a whole `UnitOfWork`, since most transactions change several kinds of records; what one asks of it,
`UnitOfWork`'s properties say in its code.
"""


def ports() -> list[type]:
    """The protocols of the ports."""
    modules = [
        importlib.import_module(f"{packaged.__name__}.{module.name}")
        for module in pkgutil.iter_modules(packaged.__path__)
    ]
    classes = [(module, found) for module in modules for found in vars(module).values() if inspect.isclass(found)]
    return [found for module, found in classes if is_protocol(found) and found.__module__ == module.__name__]


def is_protocol(found: Any) -> bool:
    return bool(getattr(found, "_is_protocol", False))


def members(port: type) -> set[str]:
    """What an adapter of the port has to write: methods and properties, those of its parents too."""
    written = [item for parent in port.__mro__ if is_protocol(parent) for item in vars(parent).items()]
    return {
        name
        for name, value in written
        if (callable(value) or isinstance(value, property)) and (not name.startswith("_") or name == "__call__")
    }


@pytest.mark.parametrize("port", ports(), ids=lambda port: port.__name__)
def test_a_port_has_few_members_those_of_its_parents_included(port):
    most, exact = MOST_MEMBERS, LARGER.get(port.__name__)
    assert len(members(port)) in ([exact] if exact else range(1, most + 1)), sorted(members(port))


def test_a_port_that_became_small_is_no_exception_any_more():
    sizes = {port.__name__: len(members(port)) for port in ports()}
    assert [name for name in LARGER if sizes.get(name, 0) <= MOST_MEMBERS] == []


def test_inherited_members_count():
    (jobs,) = (port for port in ports() if port.__name__ == "JobRepository")
    assert "get" in members(jobs) and "get" not in vars(jobs)


def test_there_are_ports_to_look_at():
    assert len(ports()) > 15


@pytest.mark.parametrize(
    "folder", ["features", "capacity", "ports", "engines", "adapters", "rest", "grpc", "wire", "worker"]
)
def test_the_states_of_jobs_and_resources_are_written_in_one_place(folder):
    enums = [enum for enum in vars(states).values() if isinstance(enum, type) and enum.__module__ == states.__name__]
    values = {member.value for enum in enums for member in enum}
    found = {
        f"{path.relative_to(ROOT)}: {node.value}"
        for path in (ROOT / "service" / folder).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Constant) and node.value in values
    }
    # The log of the index names its own kinds of changes.
    assert {entry for entry in found if "change_log" not in entry} == set()
