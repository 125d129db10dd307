"""The demo's steps as they go on: a bar in a terminal; elsewhere a line now and then, so that nothing is silent."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

SILENT_S = 5.0
"""Outside a terminal a step says at least so often how it stands."""


class Step:
    """A step that goes on: tell it how much is `done`, and of how many where that is known."""

    def __init__(self, what: str, total: int | None) -> None:
        """`what`, shortened."""
        self.what = what
        self.total = total
        self.done = 0
        self._began_s = time.monotonic()

    def advance(self) -> None:
        """One more is done."""
        self.done += 1

    @property
    def words(self) -> str:
        """Done of total, empty where nothing is counted."""
        return f"{self.done} of {self.total}" if self.total else ""

    @property
    def line(self) -> str:
        """The step as a line of text."""
        counted = f": {self.words}" if self.words else ""
        return f"{self.what}{counted}, {time.monotonic() - self._began_s:.0f} s"


@contextmanager
def step(console: Console, what: str, total: int | None = None, every_s: float = SILENT_S) -> Iterator[Step]:
    """Show a step until the block ends."""
    shown = Step(what, total)
    over = threading.Event()
    show = _as_bar if console.is_terminal else _as_lines
    thread = threading.Thread(target=show, args=(console, shown, over, every_s), name="demo-step", daemon=True)
    thread.start()
    try:
        yield shown
    finally:
        over.set()
        thread.join()


def _as_bar(console: Console, shown: Step, over: threading.Event, _: float) -> None:
    columns = (
        SpinnerColumn(finished_text="[green]+"), TextColumn("{task.description:36}"), BarColumn(),
        TextColumn("{task.fields[words]}"), TimeElapsedColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(shown.what, total=shown.total, words="")
        while not over.wait(0.2):
            progress.update(task, completed=shown.done, total=shown.total, words=shown.words)
        total = shown.total or 1
        progress.update(task, completed=shown.done if shown.total else total, total=total, words=shown.words)


def _as_lines(console: Console, shown: Step, over: threading.Event, every_s: float) -> None:
    while not over.wait(every_s):
        console.print(f"  {shown.line}", highlight=False)
    console.print(shown.line, highlight=False)
