"""Ids as the command line checks and makes them."""

from __future__ import annotations

import pytest
import typer

from revisit.cli.ids import ID, ID_CHARACTERS, id_of, require_id
from revisit.service.domain import limits


def test_the_command_line_knows_ids_as_the_service_does():
    assert (ID.pattern, ID_CHARACTERS) == (limits.ID_PATTERN, limits.ID_CHARACTERS)


@pytest.mark.parametrize(
    ("name", "made"),
    [("mon", "mon"), ("a b  c", "a-b-c"), ("überfahrt", "uberfahrt"), (".hidden", "hidden"), ("x" * 90, "x" * 64),
     ("drive (2)", "drive-2"), ("2026_11_22-10.30", "2026_11_22-10.30")],
)  # fmt: skip
def test_an_id_is_made_of_any_name_and_told_where_it_differs(name, made, capsys):
    assert id_of(name, "--session") == made == require_id("--session", made)
    assert (f"--session {made}" in capsys.readouterr().err) == (made != name)


@pytest.mark.parametrize("name", ["", "---", "運転"])
def test_a_name_that_leaves_nothing_is_refused(name, capsys):
    with pytest.raises(typer.Exit):
        id_of(name, "--session")
    assert "give one with --session" in capsys.readouterr().err


@pytest.mark.parametrize("value", ["../x", "a b", "-a", "é", "x" * 65, "a\n"])
def test_what_is_no_id_is_refused_with_the_option(value, capsys):
    with pytest.raises(typer.Exit):
        require_id("--map", value)
    assert "--map" in capsys.readouterr().err
