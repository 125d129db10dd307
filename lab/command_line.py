"""How the commands of the lab begin: one thread for every library, and lists of names as options."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

import typer

from revisit.cli.output import refuse
from revisit.service import ONE_THREAD


def run(*commands: Callable[..., Any]) -> None:
    """Run the one command, or that which the first word names; times are those of one thread."""
    os.environ.update(ONE_THREAD)  # before a library reads it: commands import those that do when they run
    app_of(*commands)()


def app_of(*commands: Callable[..., Any]) -> typer.Typer:
    """The commands of a module."""
    app = typer.Typer(pretty_exceptions_enable=False, add_completion=False)
    for command in commands:
        app.command()(command)
    return app


def named(option: str, text: str, known: Sequence[str]) -> tuple[str, ...]:
    """The names in a list with commas; all that are known for an empty one. Exits with status 1 for an unknown name."""
    names = tuple(name.strip() for name in text.split(",") if name.strip()) or tuple(known)
    unknown = [name for name in names if name not in known]
    if unknown:
        raise refuse(f"{option}: {', '.join(unknown)} is none of {', '.join(known)}")
    return names
