"""This Python, started again: how the service begins its own processes, with no import from the working directory."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import revisit


def command(*arguments: str) -> list[str]:
    """The command of this Python with `arguments`. It imports nothing from the working directory (-P)."""
    return [sys.executable, "-P", *arguments]


def environment() -> dict[str, str]:
    """This process's environment, in which `revisit` is found from any directory, and nothing for an empty entry.

    Python reads an empty entry of PYTHONPATH as the working directory.
    """
    root = str(Path(revisit.__file__).resolve().parents[1])
    others = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
    return {**os.environ, "PYTHONPATH": os.pathsep.join((root, *others))}
