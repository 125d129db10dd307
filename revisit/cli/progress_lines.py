"""Progress in lines, for a pipe or a file: a line as a stage begins, as it goes on, and as it ends."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from rich.progress import Progress, Task, TaskID

EVERY_S = 10.0


class ProgressLines(Progress):
    """A bar that is never drawn. Changes are printed every ten seconds, and at the end."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        super().__init__(disable=True)
        self._tell = tell
        self._printed: dict[TaskID, str] = {}
        self._ended = threading.Event()

    def start(self) -> None:
        """Begin to tell."""
        threading.Thread(target=self._watch, name="progress", daemon=True).start()

    def stop(self) -> None:
        """Tell how the stages have ended."""
        self._ended.set()
        self._tell_changes()

    def add_task(self, description: str, *args: Any, **fields: Any) -> TaskID:
        """See `Progress`; the stage is told at once."""
        made = super().add_task(description, *args, **fields)
        self._tell_changes()
        return made

    def _watch(self) -> None:
        while not self._ended.wait(EVERY_S):
            self._tell_changes()

    def _tell_changes(self) -> None:
        for task in self.tasks:
            line = _line(task)
            if self._printed.get(task.id) != line:
                self._printed[task.id] = line
                self._tell(line)


def _line(task: Task) -> str:
    of = "" if task.total is None else f": {task.completed:g} of {task.total:g}"
    return f"{task.description}{of}"
