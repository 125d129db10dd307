"""The source of the product, read and parsed once for all rules about it."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Module:
    """A file of ours by its path from the root."""

    name: str
    text: str

    @cached_property
    def tree(self) -> ast.Module:
        """The text, parsed when a rule asks for it first."""
        return ast.parse(self.text)


@cache
def modules(*packages: str) -> tuple[Module, ...]:
    """Every module of these folders; stubs that protoc wrote are not ours."""
    paths = sorted(path for package in packages for path in (ROOT / package).rglob("*.py"))
    found = [
        path for path in paths if "revisit/v1" not in path.as_posix() and "revisit/internal" not in path.as_posix()
    ]
    if not found:
        raise LookupError(f"there is no module in {packages}")
    return tuple(_module(path) for path in found)


@cache
def _module(path: Path) -> Module:
    return Module(path.relative_to(ROOT).as_posix(), path.read_text())


def calls(tree: ast.AST) -> list[ast.Call]:
    """Every call in it."""
    return [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
