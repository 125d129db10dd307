"""An installed copy holds what the service reads beside its code."""

from __future__ import annotations

import re
import subprocess
import tomllib
from pathlib import Path

from setuptools import find_namespace_packages

import revisit
from revisit.service.engines.schema import MIGRATIONS

ROOT = Path(__file__).resolve().parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
SETUPTOOLS = PYPROJECT["tool"]["setuptools"]


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


def test_no_file_imports_a_linked_folder_by_its_bare_name():
    # Also programs inside strings, which no linter reads: they would load a second copy of every module.
    bare = re.compile(r"(?:^|[\"'`;(]|\\n)\s*(?:from|import) (?:core|service|evaluation)[. ]", re.MULTILINE)
    listed = subprocess.run(["git", "ls-files", "*.py", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True)
    paths = [ROOT / name for name in listed.stdout.splitlines() if not name.startswith("docs/decisions/")]
    assert [path for path in paths if path.is_file() and bare.search(path.read_text())] == []
    assert bare.search('"import sys; from ' + 'core import x"') and not bare.search("from the service come")


def test_the_newest_section_of_the_changelog_and_the_ros_packages_have_the_version_of_the_project():
    version = PYPROJECT["project"]["version"]
    stated = {
        "CHANGELOG.md": r"^## (\S+) - ",
        "ros/revisit_bridge/package.xml": r"<version>(\S+)</version>",
        "ros/revisit_bridge/setup.py": r'version="(\S+)"',
        "ros/revisit_msgs/package.xml": r"<version>(\S+)</version>",
    }
    found = {name: re.search(words, (ROOT / name).read_text(), re.MULTILINE)[1] for name, words in stated.items()}
    assert found == dict.fromkeys(stated, version)
