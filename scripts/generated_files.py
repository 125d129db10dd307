"""Write or check the committed generated files: `generated_files.py write|check [NAME ...]`, all of them by default.

proto        revisit/v1/*_pb2*         out of proto/revisit/v1
parameters   docs/reference/parameters.md   out of core/config.py
openapi      docs/reference/openapi.json    out of service.rest, and service/web/docs.html out of it
references   docs/reference/{errors,settings,cli,rest-and-grpc}.md   out of the code they describe
decisions    docs/decisions/README.md   out of the decisions' own lines
"""

from __future__ import annotations

import dataclasses
import json
import runpy
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))


def write_stubs(out: Path) -> None:
    """Write the Python stubs of the protocol under `out`."""
    (out / "revisit/v1").mkdir(parents=True, exist_ok=True)
    runpy.run_path(str(ROOT / "proto/generate.py"))["generate"](out)


def write_parameters(out: Path) -> None:
    """Write the reference of every parameter of the method, one table a section, under `out`."""
    from revisit.core.config import PipelineConfig

    lines = ["# Parameters", "", "Every parameter of the method, generated from `core/config.py` by `make docs`.", ""]
    lines += _section("pipeline", PipelineConfig())
    for section in dataclasses.fields(PipelineConfig):
        if dataclasses.is_dataclass(getattr(PipelineConfig(), section.name)):
            lines += _section(section.name, getattr(PipelineConfig(), section.name))
    _write(out / "docs/reference/parameters.md", "\n".join(lines).rstrip() + "\n")


def write_openapi(out: Path) -> None:
    """Write the OpenAPI document of the HTTP interface under `out`."""
    from revisit.service.application import UseCases
    from revisit.service.rest.app import create_app

    # The document depends on the routes alone; nothing calls a use case here.
    from scripts import api_page

    document = json.dumps(create_app(cast(UseCases, None)).openapi(), indent=2, sort_keys=True) + "\n"
    _write(out / "docs/reference/openapi.json", document)
    _write(out / "service/web/docs.html", api_page.page(json.loads(document)))


def write_references(out: Path) -> None:
    """Write the reference pages of errors, settings, command line and interfaces under `out`."""
    from scripts import references

    pages = {
        "errors": references.errors,
        "settings": references.settings,
        "cli": references.command_line,
        "rest-and-grpc": references.interfaces,
    }
    for name, page in pages.items():
        _write(out / f"docs/reference/{name}.md", page())


def write_decisions(out: Path) -> None:
    """Write the index of the decisions under `out`."""
    from scripts import decisions

    _write(out / decisions.FOLDER / "README.md", decisions.index(ROOT))


GENERATORS: dict[str, Callable[[Path], None]] = {
    "proto": write_stubs,
    "parameters": write_parameters,
    "openapi": write_openapi,
    "references": write_references,
    "decisions": write_decisions,
}


def differences(names: list[str]) -> list[str]:
    """The committed files that differ from what the named generators write now."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        for name in names:
            GENERATORS[name](out)
        fresh = {path.relative_to(out) for path in out.rglob("*") if path.is_file()}
        return sorted(
            str(path)
            for path in fresh
            if not (ROOT / path).is_file() or (ROOT / path).read_bytes() != (out / path).read_bytes()
        )


def main(arguments: list[str]) -> int:
    """Run the command line; the exit status."""
    if not arguments or arguments[0] not in {"write", "check"} or not set(arguments[1:]) <= GENERATORS.keys():
        print(__doc__)
        return 2
    names = arguments[1:] or list(GENERATORS)
    if arguments[0] == "write":
        for name in names:
            GENERATORS[name](ROOT)
        return 0
    outdated = differences(names)
    for path in outdated:
        print(f"{path} is out of date: run `make proto docs` and commit the result")
    return 1 if outdated else 0


def _section(name: str, section: Any) -> list[str]:
    rows = [
        f"| `{item.name}` | {_cell(item.default)} | {_cell(item.metadata['unit'])} | {_cell(item.metadata['meaning'])}"
        f" | {_cell(item.metadata['source'])} |"
        for item in dataclasses.fields(section)
        if item.metadata
    ]
    table = ["| parameter | default | unit | meaning | source |", "|---|---|---|---|---|", *rows, ""] if rows else []
    return [f"## {name}", "", str(type(section).__doc__).strip(), "", *table]


def _cell(value: object) -> str:
    return str(value).replace("|", "\\|")


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
