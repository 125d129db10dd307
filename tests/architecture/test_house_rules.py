"""The rules of the house that no linter knows."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("core", "service", "revisit", "evaluation", "scripts")
MAX_FUNCTION_LINES = 40
FORBIDDEN_MODULES = {"utils", "util", "helpers", "helper", "common", "base", "types", "models", "manager", "misc"}


def sources() -> list[Path]:
    """Our modules; stubs that protoc wrote are not ours."""
    found = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    return sorted(path for path in found if "revisit/v1" not in path.as_posix())


def named(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def functions(tree: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    yield from (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


def code_lines(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Lines of the body without the docstring."""
    first = function.body[0]
    has_docstring = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
    statements = function.body[1:] if has_docstring else function.body
    return (function.end_lineno or 0) - statements[0].lineno + 1 if statements else 0


def public_definitions(tree: ast.Module) -> Iterator[ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef]:
    """Public classes and functions of a module, and public methods of its public classes."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and not node.name.startswith("_"):
            yield node
            if isinstance(node, ast.ClassDef):
                yield from (item for item in node.body if is_public_method(item))


def is_public_method(node: ast.stmt) -> bool:
    return isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not node.name.startswith("_")


@pytest.mark.parametrize("path", sources(), ids=named)
def test_no_function_is_longer_than_forty_lines(path):
    tree = ast.parse(path.read_text())
    long = [f"{f.name}: {code_lines(f)}" for f in functions(tree) if code_lines(f) > MAX_FUNCTION_LINES]
    assert not long


@pytest.mark.parametrize("path", sources(), ids=named)
def test_every_module_and_public_name_has_a_docstring(path):
    text = path.read_text()
    tree = ast.parse(text)
    missing = [] if ast.get_docstring(tree) or not text.strip() else ["the module"]
    missing += [node.name for node in public_definitions(tree) if not ast.get_docstring(node)]
    assert not missing


@pytest.mark.parametrize("path", sources(), ids=named)
def test_nothing_is_left_for_later(path):
    words = re.findall(r"\b(?:TODO|FIXME|XXX|NotImplementedError)\b", path.read_text())
    assert not words


def test_no_module_is_a_drawer_for_homeless_functions():
    assert not [
        named(path) for path in sources() if path.stem in FORBIDDEN_MODULES or path.parent.stem in FORBIDDEN_MODULES
    ]


def test_folders_that_would_shadow_installed_packages_are_no_packages():
    folders = [ROOT / name for name in ("proto", "docker", "migrations", "tests", "scripts", "docs")]
    assert not [named(path) for folder in folders for path in folder.rglob("__init__.py")]


def test_the_core_reads_no_environment_no_clock_and_opens_no_file():
    forbidden = re.compile(
        r"os\.environ|os\.getenv|time\.time\(|datetime\.now|(?<![\w.])open\(|\.write_(?:text|bytes)\("
    )
    # The packaged models are data of the program itself, not of a client.
    allowed = {"core/model_bundle.py"}
    found = [named(path) for path in (ROOT / "core").rglob("*.py") if forbidden.search(path.read_text())]
    assert set(found) <= allowed


def test_the_rules_notice_a_long_function_and_a_missing_docstring():
    tree = ast.parse("def f():\n" + "    x = 1\n" * 41 + "\ndef g():\n    '''Doc.'''\n")
    assert [code_lines(f) for f in functions(tree)] == [41, 0]
    assert [node.name for node in public_definitions(tree) if not ast.get_docstring(node)] == ["f"]
