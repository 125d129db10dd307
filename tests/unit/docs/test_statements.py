"""Statements of the documentation that the code could make untrue."""

from __future__ import annotations

import re
import shlex
import subprocess
from functools import cache
from itertools import takewhile
from pathlib import Path

import pytest
from typer.main import get_command

from revisit.cli.app import app
from revisit.cli.keys import revoke_key
from revisit.service import VERSION
from revisit.service.engines.schema import NEWEST_REVISION
from revisit.service.features.keys.admission import STREAM_ENDS_WITHIN_S, STREAM_RECHECK_S
from revisit.service.settings import Settings

USERS = ("how-to", "quick-start", "tutorial")
COMMAND = re.compile(r"(?:^|`)(revisit(?: [a-z][a-z-]*){1,2})(?=[ `\n])", re.MULTILINE)
LINE = re.compile(r"^ *(revisit [^`\n]*(?:\\\n[^`\n]*)*)$|`(revisit [^`\n]+)`", re.MULTILINE)
SHELL = ("|", "||", "&", "&&", ";", ">", "<")
ROOT = Path(__file__).resolve().parents[3]


def page(name: str) -> str:
    """A page of the documentation, as one line."""
    return " ".join((ROOT / "docs" / name).read_text().split())


def test_a_revoked_key_ends_open_streams_within_one_time_everywhere():
    assert 2 * STREAM_RECHECK_S <= STREAM_ENDS_WITHIN_S
    within = f"within {STREAM_ENDS_WITHIN_S:g} s"
    told = [page("how-to/secure-a-deployment.md"), revoke_key.__doc__, (ROOT / "revisit/cli/keys.py").read_text()]
    sentences = [found for text in told for found in re.findall(r"open streams? ends? (within \S+ s)\b", text)]
    assert len(sentences) >= 3 and set(sentences) == {within}


def test_the_quick_start_for_cpp_names_every_package_that_its_commands_need():
    told = page("quick-start/cpp.md")
    named = re.search(r"apt-get install ([^`]+?) ```", told)[1].split()
    # protoc, its plugin, the headers and libraries of both, and what compiles and links.
    assert {"protobuf-compiler", "protobuf-compiler-grpc", "libprotobuf-dev", "libgrpc++-dev"} <= set(named)
    assert {"g++", "pkg-config"} <= set(named)


def test_the_page_of_bytes_tells_of_the_policy_that_there_is():
    assert "retention" in Settings.model_fields and Settings().retention == ""
    told = page("reference/measurements.md")
    assert "Every scan is kept unless a [policy](../how-to/keep-a-store-small.md) says otherwise" in told


def test_the_two_counts_of_keypoints_are_told_apart():
    told = page("how-to/read-an-answer.md")
    assert "`evidence.measurement.inliers` | keypoints that agree on a first guess of the pose" in told
    assert "with the final pose" in page("how-to/look-at-a-map.md")


def test_the_schema_that_a_downgrade_names_is_that_of_the_release():
    assert f"The schema of {VERSION} is {NEWEST_REVISION}." in page("reference/stability.md")


@pytest.mark.parametrize("path", sorted((ROOT / "docs/how-to").glob("*.md")), ids=lambda path: path.stem)
def test_a_how_to_is_a_page_of_a_hundred_lines(path):
    assert len(path.read_text().splitlines()) <= 100


def test_the_readme_has_a_hundred_and_twenty_lines_at_most():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 120


def test_each_command_that_a_page_for_users_names_is_one():
    groups = {("revisit",): _revisit().commands}
    groups |= {
        ("revisit", name): one.commands for name, one in groups[("revisit",)].items() if hasattr(one, "commands")
    }
    pages = [ROOT / "README.md", *(file for part in USERS for file in (ROOT / "docs" / part).glob("*.md"))]
    said = [(path.name, tuple(words.split())) for path in pages for words in COMMAND.findall(path.read_text())]
    assert len(said) > 100
    unknown = [
        (name, words)
        for name, words in said
        for group, commands in groups.items()
        if words[: len(group)] == group and len(words) > len(group) and words[len(group)] not in commands
    ]
    assert unknown == []


def test_each_option_that_a_page_for_users_gives_to_a_command_is_one_of_it():
    pages = [ROOT / "README.md", *(file for part in USERS for file in (ROOT / "docs" / part).glob("*.md"))]
    lines = [(path.name, line) for path in pages for pair in LINE.findall(path.read_text()) for line in pair if line]
    assert len(lines) > 100
    assert [(name, line, said) for name, line in lines if (said := _unknown_in(line))] == []


@cache
def _revisit():
    return get_command(app)


def _unknown_in(line: str) -> list[str]:
    """The options of a line of the shell that its command of `revisit` does not have."""
    words = list(takewhile(lambda word: word not in SHELL, shlex.split(line.replace("\\\n", " "), comments=True)[1:]))
    command = _revisit()
    while words and words[0] in getattr(command, "commands", {}):
        command = command.commands[words.pop(0)]
    known = {name for option in command.params for name in (*option.opts, *option.secondary_opts)} | {"--help"}
    return [word for word in words if word.startswith("--") and word.partition("=")[0] not in known]


def test_the_text_of_a_tag_is_the_section_of_its_release():
    (command,) = re.findall(r"^awk .*(?= \| git tag)", (ROOT / "docs/reference/stability.md").read_text(), re.MULTILINE)
    text = subprocess.run(command, shell=True, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    assert text.startswith(f"## {VERSION} - ") and "### You must" in text and text.count("\n## ") == 0
