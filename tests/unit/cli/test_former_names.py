"""A command that is gone answers with the one in its place."""

from __future__ import annotations

import pytest
import typer
from typer.testing import CliRunner

from revisit.cli.app import app
from revisit.cli.former_names import FORMER


@pytest.mark.parametrize("name", FORMER)
def test_a_former_command_ends_with_the_one_in_its_place(name):
    answer = CliRunner().invoke(app, [*name.split(), "anything", "--whatever"])
    assert answer.exit_code == 2
    said = " ".join(answer.output.replace("│", " ").split())
    assert f"`revisit {name}` is now `{FORMER[name]}`" in said


@pytest.mark.parametrize("name", FORMER)
def test_the_command_in_the_place_of_a_former_one_exists(name):
    program, first, second, *_ = FORMER[name].replace("--", " --").split()
    if program == "revisit":
        commands = typer.main.get_command(app).commands
        assert first in commands
        assert not hasattr(commands[first], "commands") or second in commands[first].commands


def test_a_decision_is_one_and_has_its_loop():
    for words in (["--accept"], ["loop-1-2"], ["loop-1-2", "--accept", "--reject"], ["--note", "why"]):
        refused = CliRunner().invoke(app, ["loops", *words])
        assert refused.exit_code == 1 and "give NAME with one of" in refused.output
