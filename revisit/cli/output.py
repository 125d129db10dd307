"""How commands speak: JSON on stdout with `--json`, else tables for people; progress and errors on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import typer

from revisit.cli.heartbeat import Heartbeat

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

PIPE_WIDTH = 400

signs = Heartbeat("at work", lambda doing: typer.echo(f"revisit: {doing} ...", err=True))
"""The heartbeat of this process; `revisit.cli.app.run` starts it."""


def emit_json(value: Any) -> None:
    """One JSON document on stdout."""
    typer.echo(json.dumps(value, indent=1, default=plain, allow_nan=False))


def emit_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """A table on stdout; cells are shown as they are, without markup."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for column in columns:
        table.add_column(column, overflow="fold")
    for row in rows:
        table.add_row(*(_cell(value) for value in row))
    # Into a pipe or a file every row is one line, however long its names are.
    width = None if sys.stdout.isatty() else PIPE_WIDTH
    Console(markup=False, width=width).print(table)


def say(message: str) -> None:
    """A sentence on stdout."""
    typer.echo(message)


def counted(number: int, thing: str) -> str:
    """So many things: `1 anchor`, `2 anchors`."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def confirm(question: str, yes: bool) -> None:
    """Ask before something is lost, unless `yes`. Exits where the answer is no."""
    if not yes:
        typer.confirm(question, abort=True)


def utc(at_ns: int | None) -> str:
    """A time in nanoseconds since 1970, to the second; nothing for None."""
    return "" if at_ns is None else datetime.fromtimestamp(at_ns // 10**9, UTC).strftime("%Y-%m-%d %H:%M:%S")


def refuse(message: str) -> typer.Exit:
    """The exit of a command that cannot go on, its reason on stderr."""
    typer.echo(message, err=True)
    return typer.Exit(1)


@contextmanager
def progress_bar(quiet: bool) -> Iterator[Progress]:
    """Progress on stderr: a bar on a terminal, else lines; nothing where `quiet`."""
    from rich import progress
    from rich.console import Console

    from revisit.cli.progress_lines import ProgressLines

    if quiet:
        yield progress.Progress(disable=True)
        return
    columns = (
        progress.TextColumn("{task.description}", markup=False),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    shown = progress.Progress(*columns, console=console) if console.is_terminal else ProgressLines(tell)
    with signs.shown(lambda: not shown.finished), shown:
        yield shown


def tell(line: str) -> None:
    """A line on stderr."""
    typer.echo(line, err=True)


def reporter(bar: Progress) -> Callable[[str, int, int], None]:
    """A progress callback (stage, done, total): one line of `bar` for each stage."""
    tasks: dict[str, TaskID] = {}

    def report(stage: str, done: int, total: int) -> None:
        if stage not in tasks:
            tasks[stage] = bar.add_task(stage, total=total)
        bar.update(tasks[stage], completed=done, total=total)

    return report


def plain(value: Any) -> Any:
    """A value of NumPy for JSON. Raises TypeError for anything else."""
    import numpy as np

    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"cannot write {type(value).__name__} as JSON")


def _cell(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float) else "" if value is None else str(value)
