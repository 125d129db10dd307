"""A submap may be named in short, or as the service prints it."""

from __future__ import annotations

import pytest
import typer

from revisit.cli.submap_names import full_name, short_name

NAME = "maps/yard/sessions/monday/submaps/start"


@pytest.mark.parametrize("written", ["monday/start", NAME])
def test_a_submap_is_named_in_short_or_in_full(written):
    assert full_name("yard", written) == NAME
    assert short_name(NAME) == "monday/start"


@pytest.mark.parametrize("written", ["", "start", "monday/", "yard/monday/start", NAME.replace("submaps", "loops")])
def test_what_names_no_submap_is_refused(written):
    with pytest.raises(typer.Exit):
        full_name("yard", written)
