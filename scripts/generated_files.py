"""Write or check the committed generated files: `generated_files.py write|check [NAME ...]`, all of them by default.

proto        revisit/{v1,internal/v1}/*_pb2*   out of proto/revisit
parameters   docs/reference/parameters.md   out of core/config.py
openapi      docs/reference/openapi.json    out of service.rest, and service/web/docs.html out of it
references   docs/reference/{errors,settings,cli,rest-and-grpc,sdk}.md   out of the code they describe
resources    revisit/sdk/resources.py   out of the messages
async        revisit/sdk/async_client.pyi   out of the groups of calls of the SDK
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
    for package in ("revisit/v1", "revisit/internal/v1"):
        (out / package).mkdir(parents=True, exist_ok=True)
    runpy.run_path(str(ROOT / "proto/generate.py"))["generate"](out)


OF_AN_OPERATOR = {
    "submap.tau": ("REVISIT_TAU_M", "tau_m"),
    "submap.stride": ("REVISIT_STRIDE_M", "stride_m"),
    "scene_scale": ("", "scene_scale"),
    "profile": ("", "profile"),
    "loop.leave_distance": ("", "leave_distance_m"),
    "loop.candidates": ("", "loop_policy.candidates"),
    "verification.min_score": ("", "loop_policy.min_score"),
    "verification.min_overlap": ("", "loop_policy.min_overlap"),
    "verification.max_seen_through": ("", "loop_policy.max_seen_through"),
}
"""The parameters that can be set without changing the code: by a setting, and by a field of a map."""


def write_parameters(out: Path) -> None:
    """Write the reference of the parameters that an operator can set under `out`."""
    from revisit.core.config import PipelineConfig

    lines = [
        "# Parameters",
        "",
        "The parameters of the method that can be set, for the service or for one map. All others are declared in",
        "`core/config.py`, each with its unit and source.",
        "",
        "| parameter | setting | of a map | default | unit | meaning | source |",
        "|---|---|---|---|---|---|---|",
    ]
    config = PipelineConfig()
    _write(
        out / "docs/reference/parameters.md",
        "\n".join([*lines, *(_row(config, name) for name in OF_AN_OPERATOR)]) + "\n",
    )


def write_openapi(out: Path) -> None:
    """Write the OpenAPI document of the HTTP interface under `out`."""
    from revisit.service.rest.app import create_app
    from revisit.service.use_cases import UseCases

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
        "sdk": references.sdk,
    }
    for name, page in pages.items():
        _write(out / f"docs/reference/{name}.md", page())


def write_resources(out: Path) -> None:
    """Write the resources of the SDK under `out`."""
    from scripts import sdk_resources

    _write(out / sdk_resources.PATH, sdk_resources.module())


def write_async_stub(out: Path) -> None:
    """Write the types of the asynchronous client under `out`."""
    from scripts import async_stub

    _write(out / async_stub.PATH, async_stub.stub())


def write_decisions(out: Path) -> None:
    """Write the index of the decisions under `out`."""
    from scripts import decisions

    _write(out / decisions.FOLDER / "README.md", decisions.index(ROOT))


GENERATORS: dict[str, Callable[[Path], None]] = {
    "proto": write_stubs,
    "resources": write_resources,
    "parameters": write_parameters,
    "openapi": write_openapi,
    "references": write_references,
    "async": write_async_stub,
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


def _row(config: Any, name: str) -> str:
    """The line of a parameter, named by its path from the whole configuration."""
    section, _, last = name.rpartition(".")
    holder = getattr(config, section) if section else config
    (item,) = (one for one in dataclasses.fields(holder) if one.name == last)
    setting, of_map = (f"`{word}`" if word else "" for word in OF_AN_OPERATOR[name])
    about = (_cell(item.metadata[key]) for key in ("unit", "meaning", "source"))
    return f"| {' | '.join((f'`{name}`', setting, of_map, _cell(getattr(holder, last)), *about))} |"


def _cell(value: object) -> str:
    return str(value).replace("|", "\\|")


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
