"""The rules of the house that no linter knows."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import PurePath

from tests.support.sources import ROOT, modules

OURS = modules("core", "service", "revisit", "evaluation", "lab", "scripts")
MAX_FUNCTION_LINES = 40
FORBIDDEN_MODULES = {"utils", "util", "helpers", "helper", "common", "base", "types", "models", "manager", "misc"}


def functions(tree: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    yield from (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))


def is_long(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether its body, without the docstring, has more lines than a function may have."""
    statements = function.body[1:] if ast.get_docstring(function) else function.body
    return bool(statements) and (function.end_lineno or 0) - statements[0].lineno >= MAX_FUNCTION_LINES


def undocumented(tree: ast.Module) -> list[str]:
    """The public names without a docstring; an empty module needs none."""
    missing = ["the module"] if tree.body and not ast.get_docstring(tree) else []
    return missing + [node.name for node in public_definitions(tree) if not ast.get_docstring(node)]


def public_definitions(tree: ast.Module) -> Iterator[ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef]:
    """Public classes and functions of a module, and public methods of its public classes."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and not node.name.startswith("_"):
            yield node
            if isinstance(node, ast.ClassDef):
                yield from (item for item in node.body if is_public_method(item))


def is_public_method(node: ast.stmt) -> bool:
    return isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not node.name.startswith("_")


def test_no_function_is_longer_than_forty_lines():
    found = [
        (module.name, function.name) for module in OURS for function in functions(module.tree) if is_long(function)
    ]
    assert found == []


def test_every_module_and_public_name_has_a_docstring():
    assert [(module.name, name) for module in OURS for name in undocumented(module.tree)] == []


def misnamed(name: str, tree: ast.AST, text: str) -> bool:
    """Whether a file of a feature is named for another process, or another kind of work, than its own."""
    waits = any(isinstance(function, ast.AsyncFunctionDef) for function in functions(tree))
    match name.removesuffix(".py").rpartition("_")[2]:
        case "calls":
            return not waits
        case "job":
            return waits
        case "rows":
            return waits
        case "rules":
            return waits or "UnitOfWork" in text
    return False


def test_the_name_of_a_file_of_a_feature_says_which_process_runs_it():
    of_features = [module for module in OURS if module.name.startswith("service/features/")]
    assert len(of_features) > 80
    assert [one.name for one in of_features if misnamed(PurePath(one.name).name, one.tree, one.text)] == []


def test_nothing_is_left_for_later():
    later = re.compile(r"\b(?:TODO|FIXME|XXX|NotImplementedError)\b")
    assert [(module.name, word) for module in OURS for word in later.findall(module.text)] == []


def test_no_module_is_a_drawer_for_homeless_functions():
    names = {module.name: set(PurePath(module.name).with_suffix("").parts) for module in OURS}
    assert [name for name, parts in names.items() if parts & FORBIDDEN_MODULES] == []


def test_folders_that_would_shadow_installed_packages_are_no_packages():
    folders = [ROOT / name for name in ("proto", "docker", "lab", "migrations", "tests", "scripts", "docs")]
    assert [path for folder in folders for path in folder.rglob("__init__.py")] == []


def test_the_core_reads_no_environment_no_clock_and_opens_no_file():
    forbidden = re.compile(
        r"os\.environ|os\.getenv|time\.time\(|datetime\.now|(?<![\w.])open\(|\.write_(?:text|bytes)\("
    )
    # The packaged models are data of the program itself, not of a client.
    allowed = {"core/model_bundle.py"}
    assert {module.name for module in modules("core") if forbidden.search(module.text)} <= allowed


def test_the_rules_notice_a_long_function_and_a_missing_docstring():
    tree = ast.parse("def f():\n" + "    x = 1\n" * 41 + "\ndef g():\n    '''Doc.'''\n" + "    x = 1\n" * 40)
    assert [(f.name, is_long(f)) for f in functions(tree)] == [("f", True), ("g", False)]
    assert undocumented(tree) == ["the module", "f"]


def test_the_listing_of_core_names_every_part_and_nothing_else():
    listing = ast.get_docstring(ast.parse((ROOT / "core/__init__.py").read_text())) or ""
    stages = {name for line in listing.splitlines() if line.startswith("    ") for name in line[4:28].split(", ")}
    beside = " ".join(listing.split("Beside them")[1].split("\n\n")[0].split())
    others = set(re.findall(r"[:,] ([a-z_]+)(?= \(|\.)", beside))
    there = {path.stem for path in (ROOT / "core").iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    assert {name.strip() for name in stages} | others == there - {"__init__"}
