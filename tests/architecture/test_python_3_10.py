"""The client, and the ROS 2 bridge without rclpy, run with Python 3.10 as ROS 2 Humble has it.

No test runs that version: these read the modules that the client loads.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

from revisit.formats.ascii_rows import NUMBERS, greedy

ROOT = Path(__file__).resolve().parents[2]
BRIDGE = ROOT / "ros/revisit_bridge/revisit_bridge"
LOADED = """
import importlib, pkgutil, sys
import revisit.sdk
for found in pkgutil.walk_packages(revisit.sdk.__path__, "revisit.sdk."):
    importlib.import_module(found.name)
import revisit_bridge
for found in pkgutil.iter_modules(revisit_bridge.__path__, "revisit_bridge."):
    if found.name.rpartition(".")[2] not in ("node", "lifecycle_node"):
        importlib.import_module(found.name)
for name, module in sys.modules.items():
    if name.partition(".")[0] in ("revisit", "revisit_bridge"):
        print(module.__file__)
"""
NEWER = {
    "asyncio": {"Barrier", "Runner", "TaskGroup", "eager_task_factory", "timeout", "timeout_at"},
    "builtins": {"BaseExceptionGroup", "ExceptionGroup", "PythonFinalizationError"},
    "contextlib": {"chdir"},
    "datetime": {"UTC"},
    "enum": {"CONTINUOUS", "EnumCheck", "EnumType", "FlagBoundary", "NAMED_FLAGS", "ReprEnum", "StrEnum", "UNIQUE",
             "global_enum", "member", "nonmember", "property", "verify"},
    "hashlib": {"file_digest"},
    "http": {"HTTPMethod"},
    "inspect": {"getmembers_static", "markcoroutinefunction"},
    "itertools": {"batched"},
    "logging": {"getHandlerByName", "getHandlerNames", "getLevelNamesMapping"},
    "math": {"cbrt", "exp2", "fma", "sumprod"},
    "operator": {"call", "is_none"},
    "os": {"process_cpu_count"},
    "re": {"NOFLAG"},
    "sqlite3": {"Blob"},
    "sys": {"activate_stack_trampoline", "exception", "monitoring"},
    "threading": {"setprofile_all_threads", "settrace_all_threads"},
    "typing": {"LiteralString", "Never", "NoDefault", "NotRequired", "ReadOnly", "Required", "Self", "TypeAliasType",
               "TypeIs", "TypeVarTuple", "Unpack", "assert_never", "assert_type", "clear_overloads",
               "dataclass_transform", "get_overloads", "get_protocol_members", "override", "reveal_type"},
    "tomllib": None,
}  # fmt: skip
"""Names of the standard library that came after 3.10, of the modules that are in use here."""


@pytest.fixture(scope="module")
def loaded() -> list[Path]:
    told = subprocess.run(
        [sys.executable, "-c", LOADED], cwd=BRIDGE.parent, env={"PYTHONPATH": f"{ROOT}:{BRIDGE.parent}"},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return sorted(map(Path, told.stdout.split()))


def newer(source: str) -> list[str]:
    """What a module uses that Python 3.10 does not have. Raises SyntaxError for what it cannot read."""
    tree = ast.parse(source, feature_version=(3, 10))
    optional = {id(inner) for node in ast.walk(tree) for block in _optional(node) for inner in ast.walk(block)}
    nodes = [node for node in ast.walk(tree) if id(node) not in optional]
    return [name for node in nodes for name in _names(node) if _is_newer(name)] + [
        pattern for node in nodes if isinstance(node, ast.Call) for pattern in _possessive(node)
    ]


def _optional(node: ast.AST) -> list[ast.stmt]:
    """What is not run with 3.10, or may fail there."""
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        return node.body
    if isinstance(node, ast.Try) and any("ImportError" in ast.unparse(one.type) for one in node.handlers if one.type):
        return node.body
    return []


def _names(node: ast.AST) -> list[str]:
    if isinstance(node, ast.ImportFrom):
        return [f"{node.module}.{alias.name}" for alias in node.names]
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.Attribute):
        return [ast.unparse(node)]
    return [f"builtins.{node.id}"] if isinstance(node, ast.Name) else []


def _possessive(call: ast.Call) -> list[str]:
    """The pattern of a call of `re`, where its repetitions give nothing back."""
    if not ast.unparse(call.func).startswith("re.") or not call.args or not isinstance(call.args[0], ast.Constant):
        return []
    value = call.args[0].value
    pattern = value.decode() if isinstance(value, bytes) else str(value)
    sets_left_out = re.sub(r"\\.|\[[^]]*\]", "x", pattern)
    return [pattern] if re.search(r"[*+?}]\+|\(\?>", sets_left_out) else []


def _is_newer(name: str) -> bool:
    module, _, own = name.partition(".")
    return module in NEWER and (NEWER[module] is None or own in NEWER[module])


def test_the_client_and_the_bridge_use_nothing_that_python_3_10_does_not_have(loaded) -> None:
    assert len(loaded) > 90 and BRIDGE / "bridge.py" in loaded
    found = {str(path): newer(path.read_text()) for path in [*loaded, BRIDGE / "node.py", BRIDGE / "lifecycle_node.py"]}
    assert {path: names for path, names in found.items() if names} == {}


@pytest.mark.parametrize(
    ("source", "names"),
    [
        ("from typing import Any, Self", ["typing.Self"]), ("hashlib.file_digest(a)", ["hashlib.file_digest"]),
        ("re.compile(r'a*+b')", ["a*+b"]), ("re.fullmatch(rb'(?>a)b', c)", ["(?>a)b"]), ("re.match(r'a+[*+]', c)", []),
        ("raise ExceptionGroup('a', [])", ["builtins.ExceptionGroup"]), ("import tomllib", ["tomllib"]),
        ("if TYPE_CHECKING:\n    from typing import Self", []), ("from enum import Enum", []),
        ("try:\n    from enum import StrEnum\nexcept ImportError:\n    pass", []),
    ],
)  # fmt: skip
def test_names_that_are_newer_are_found(source, names) -> None:
    assert newer(source) == names


def test_a_syntax_that_is_newer_is_found() -> None:
    with pytest.raises(SyntaxError):
        newer("try:\n    pass\nexcept* ValueError:\n    pass")


@pytest.mark.parametrize(
    "text", [b" 1 -2.5e3\tnan\n", b"inf .5 1. ", b"", b"1x", b"1_0", b"0x1 2", b"1 2 3 e5", b"1e5 --2"]
)
def test_numbers_are_read_alike_where_repetitions_may_give_back(text) -> None:
    possessive, giving = (re.compile(pattern, re.IGNORECASE) for pattern in (NUMBERS, greedy(NUMBERS)))
    assert greedy(NUMBERS) != NUMBERS and possessive.match(text).end() == giving.match(text).end()


def test_the_command_says_that_it_needs_a_later_python(monkeypatch) -> None:
    from revisit.cli import main

    monkeypatch.setattr(sys, "version_info", (3, 10, 13))
    with pytest.raises(SystemExit, match=r"the command needs Python 3\.11 or later"):
        main()
