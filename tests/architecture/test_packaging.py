"""An installed copy holds what the service reads beside its code."""

from __future__ import annotations

import tomllib
from pathlib import Path

from setuptools import find_namespace_packages

from service.adapters.sql.migration import MIGRATIONS

ROOT = Path(__file__).resolve().parents[2]
SETUPTOOLS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]


def installed_folders() -> set[str]:
    packages = find_namespace_packages(str(ROOT), include=SETUPTOOLS["packages"]["find"]["include"])
    return {package.replace(".", "/") for package in packages}


def test_every_migration_is_installed_where_the_service_looks_for_it():
    # The service looks beside its own package, where an installer puts all packages of one project.
    assert MIGRATIONS == ROOT / "migrations"
    folders = {path.parent.relative_to(ROOT).as_posix() for path in MIGRATIONS.rglob("*.py")}
    assert folders == {"migrations", "migrations/versions"} and folders <= installed_folders()


def test_nothing_but_the_program_is_installed():
    assert {folder.partition("/")[0] for folder in installed_folders()} == {
        "core",
        "service",
        "revisit",
        "evaluation",
        "migrations",
    }
