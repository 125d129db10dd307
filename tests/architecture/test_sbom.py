"""The software bill of materials names what is installed: all of it, and nothing else."""

from __future__ import annotations

import json
import sysconfig
from importlib import metadata

import pytest
from packaging.utils import canonicalize_name

from scripts.sbom import VENDORED, write_sbom

# Making the bill reads every file that is installed.
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def bill(tmp_path_factory):
    file = tmp_path_factory.mktemp("sbom") / "sbom.cdx.json"
    write_sbom(file)
    return json.loads(file.read_text())


def test_the_bill_names_exactly_what_is_installed(bill):
    vendored = {(part["name"], part["version"]) for part in json.loads(VENDORED.read_text())}
    listed = {(canonicalize_name(part["name"]), part["version"]) for part in bill["components"]}
    assert vendored < listed
    # Not along sys.path, to which setuptools, once imported, adds the parts that it carries.
    folders = sorted({sysconfig.get_path(name) for name in ("purelib", "platlib")})
    installed = {(canonicalize_name(found.name), found.version) for found in metadata.distributions(path=folders)}
    assert len(listed) > 100
    assert listed - vendored == installed


def test_the_bill_is_of_a_version_that_tools_read_and_says_how_parts_depend_on_each_other(bill):
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.6")
    numbers = {part["bom-ref"] for part in bill["components"] if "pkg:npm" not in part["bom-ref"]}
    assert {entry["ref"] for entry in bill["dependencies"]} >= numbers


def test_the_bill_carries_no_time_and_no_number_of_its_own(bill):
    assert "serialNumber" not in bill
    assert "timestamp" not in bill["metadata"]
