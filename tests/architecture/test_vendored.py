"""What the page brings of others: as it was published, with its licence, and listed."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
VENDOR = ROOT / "service" / "web" / "vendor"
LISTED = json.loads((VENDOR / "vendored.json").read_text())
BARE = b"from './three.module.js';"
PUBLISHED = b"from 'three';"


BESIDE, APART = b"from './{}.js';", b"from '../utils/{}.js';"


def as_published(data):
    """The file with the names by which it imported others."""
    for name in (b"BufferGeometryUtils", b"SkeletonUtils"):
        data = data.replace(BESIDE.replace(b"{}", name), APART.replace(b"{}", name))
    return data.replace(BARE, PUBLISHED)


@pytest.mark.parametrize("part", LISTED, ids=lambda part: part["name"])
def test_a_vendored_part_is_listed_with_version_licence_and_each_of_its_files(part):
    folder = VENDOR / f"{part['name']}-{part['version']}"
    assert {file.name for file in folder.iterdir()} == set(part["files"])
    assert part["licence"] in ("MIT", "Apache-2.0")
    first = (folder / "LICENSE").read_text().lstrip().splitlines()[0].strip()
    assert first.removeprefix("The ") == {"MIT": "MIT License", "Apache-2.0": "Apache License"}[part["licence"]]
    assert part["purl"] == f"pkg:npm/{part['name']}@{part['version']}"


@pytest.mark.parametrize("part", LISTED, ids=lambda part: part["name"])
def test_the_files_are_those_that_were_published_but_for_the_name_they_import_by(part):
    folder = VENDOR / f"{part['name']}-{part['version']}"
    for name, known in part["files"].items():
        data = (folder / name).read_bytes()
        assert hashlib.sha256(data).hexdigest() == known["sha256"], name
        original = data if name.startswith("three.") else as_published(data)
        assert hashlib.sha256(original).hexdigest() == known["original_sha256"], name


def test_nothing_is_vendored_that_is_not_listed():
    folders = {path.name for path in VENDOR.iterdir() if path.is_dir()}
    assert folders == {f"{part['name']}-{part['version']}" for part in LISTED}
