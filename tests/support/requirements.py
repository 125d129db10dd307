"""What an installation of the project consists of: its extras as pyproject.toml declares them, followed to the end."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = tuple(PROJECT["optional-dependencies"])
# Interpreters and machines that the project supports.
PLATFORMS = [
    {"python_version": version, "python_full_version": f"{version}.1", **platform}
    for version in ("3.11", "3.12", "3.13")
    for platform in (
        {"sys_platform": "linux", "platform_system": "Linux", "platform_machine": "x86_64"},
        {"sys_platform": "linux", "platform_system": "Linux", "platform_machine": "aarch64"},
        {"sys_platform": "darwin", "platform_system": "Darwin", "platform_machine": "arm64"},
    )
]


def direct(extra: str = "") -> Iterator[Requirement]:
    """The requirements of an extra, those of the extras it contains included; without one, those of the SDK alone."""
    texts = PROJECT["optional-dependencies"][extra] if extra else PROJECT["dependencies"]
    for requirement in map(Requirement, texts):
        if requirement.name == PROJECT["name"]:
            for contained in requirement.extras:
                yield from direct(contained)
        else:
            yield requirement


def everything(extra: str = "") -> Iterator[Requirement]:
    """The requirements of an installation with an extra: the SDK's own first."""
    yield from direct()
    if extra:
        yield from direct(extra)


def distributions(extra: str = "", environment: dict[str, str] | None = None) -> set[str]:
    """The names of all that an installation with an extra brings, found from installed metadata, itself left out.

    For another `environment` (markers of PEP 508) what is not installed here is named without its own requirements.
    """
    found: set[tuple[str, str]] = set()
    waiting = [(requirement, "") for requirement in everything(extra)]
    while waiting:
        requirement, parent_extra = waiting.pop()
        marked = {**(environment or {}), "extra": parent_extra}
        if requirement.marker is not None and not requirement.marker.evaluate(marked):
            continue
        for wanted in ("", *requirement.extras):
            key = (canonicalize_name(requirement.name), wanted)
            if key not in found:
                found.add(key)
                waiting += [(Requirement(text), wanted) for text in _requires(requirement.name, environment is None)]
    return {name for name, _ in found}


def _requires(name: str, must_be_installed: bool) -> list[str]:
    try:
        return metadata.distribution(name).requires or []
    except metadata.PackageNotFoundError:
        if must_be_installed:
            raise
        return []
