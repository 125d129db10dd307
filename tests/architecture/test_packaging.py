"""An installed copy holds what the service reads beside its code."""

from __future__ import annotations

import tomllib
from pathlib import Path

from setuptools import find_namespace_packages

import revisit
from revisit.service.adapters.sqlite.migration import MIGRATIONS

ROOT = Path(__file__).resolve().parents[2]
SETUPTOOLS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]


def installed_folders() -> set[str]:
    packages = find_namespace_packages(str(ROOT), include=SETUPTOOLS["packages"]["find"]["include"])
    return {package.replace(".", "/") for package in packages}


def test_every_migration_is_installed_where_the_service_looks_for_it():
    assert MIGRATIONS.samefile(ROOT / "migrations")
    assert {"revisit/migrations", "revisit/migrations/versions"} <= installed_folders()
    installed = Path(revisit.__file__).parent / "migrations"
    assert installed.samefile(MIGRATIONS)


def test_nothing_is_installed_beside_the_name_revisit():
    assert {folder.partition("/")[0] for folder in installed_folders()} == {"revisit"}
    assert {"revisit/core", "revisit/service", "revisit/evaluation", "revisit/sdk", "revisit/v1"} <= installed_folders()
