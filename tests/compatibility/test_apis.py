"""Clients of an earlier release find its messages and calls in this version (P27)."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from revisit.api.calls import CALLS
from tests.compatibility.write import APIS, ROOT, buf, public_names, write_api

RULES = json.dumps({"version": "v2", "breaking": {"use": ["PACKAGE"]}})
"""Names, numbers, types and calls stay; new ones may come."""

ANNOUNCED: dict[str, str] = {}
"""Difference in buf's words, or name that is gone -> the release whose changelog announced it: see
docs/reference/stability.md."""


def differences(release: Path, proto: Path = ROOT / "proto") -> set[str]:
    """Changes that break clients of a release, in buf's words without their line."""
    compared = buf("breaking", "--config", RULES, "--error-format", "json", "--against", str(release), proto=proto)
    assert compared.stderr == ""
    return {json.loads(line)["message"] for line in compared.stdout.splitlines()}


@pytest.mark.parametrize("release", sorted(APIS.glob("*.binpb")), ids=lambda release: release.stem)
def test_clients_of_an_earlier_release_find_every_message_field_and_call(release):
    assert differences(release) <= set(ANNOUNCED)


@pytest.mark.parametrize("release", sorted(APIS.glob("*.txt")), ids=lambda release: release.stem)
def test_users_of_an_earlier_release_find_every_method_command_setting_and_error_code(release):
    names = set(release.read_text().splitlines())
    assert {"client.maps.create", "revisit serve", "REVISIT_HOME", "NOT_FOUND"} <= names
    assert names - public_names() <= set(ANNOUNCED)


def test_a_field_that_is_gone_and_one_of_another_type_are_found(tmp_path):
    write_api(tmp_path / "today.binpb")
    changed = shutil.copytree(ROOT / "proto", tmp_path / "proto")
    file = changed / "revisit/v1/geometry.proto"
    file.write_text(file.read_text().replace("double x = 1;", "", 1).replace("double y = 2;", "float y = 2;", 1))
    retyped, deleted = sorted(differences(tmp_path / "today.binpb", changed))
    assert '"1"' in deleted and "deleted" in deleted
    assert '"y"' in retyped and "float" in retyped


def test_nothing_is_deprecated_before_the_sdk_warns_of_it():
    """As docs/reference/stability.md says; the first mark brings a DeprecationWarning of the SDK, and its own test."""
    methods = [call.method for call in CALLS.values()]
    fields = [field for method in methods for kind in (method.input_type, method.output_type) for field in kind.fields]
    assert len(fields) > 100
    assert [one.full_name for one in (*methods, *fields) if one.GetOptions().deprecated] == []
