"""Ids that a person chooses, or that are made of the name of a file."""

from __future__ import annotations

import re
import unicodedata

import typer

from revisit.cli.output import refuse

ID_CHARACTERS = 64
ID = re.compile(rf"[A-Za-z0-9][A-Za-z0-9._-]{{0,{ID_CHARACTERS - 1}}}")
"""As the service has it; a test compares them."""

_RULE = f"1 to {ID_CHARACTERS} of A-Z a-z 0-9 . _ -, and begins with a letter or a digit"
_OTHERS = re.compile(r"[^A-Za-z0-9._-]+")


def require_id(option: str, value: str) -> str:
    """`value`, if it is a valid id for `option`. Exits otherwise."""
    if ID.fullmatch(value) is None:
        raise refuse(f"{option} {value!r} cannot be an id: that is {_RULE}")
    return value


def id_of(name: str, option: str) -> str:
    """An id like the name of a file, which goes to stderr where it had to be changed.

    Letters lose their accents, and `-` replaces characters that an id cannot hold. Exits where nothing is left;
    `option` gives another id.
    """
    plain = "".join(mark for mark in unicodedata.normalize("NFKD", name) if not unicodedata.combining(mark))
    made = _OTHERS.sub("-", plain).lstrip("._-")[:ID_CHARACTERS].rstrip("-")
    if not made:
        raise refuse(f"no id can be made of the name {name!r}: give one with {option}, {_RULE}")
    if made != name:
        typer.echo(
            f"{option} {made}: made of the name {name!r}, which cannot be an id; {option} gives another", err=True
        )
    return made
