"""C libraries beside these tests that are preloaded into the real service: compiled here."""

from __future__ import annotations

import shutil
import struct
import subprocess
from pathlib import Path
from typing import Protocol

COMPILER = shutil.which("cc")

OPTIONS = ("-shared", "-fPIC", "-O2", "-Wall", "-Wextra", "-Werror", "-D_GNU_SOURCE")


class Preloaded(Protocol):
    """A library, and the variables that it reads."""

    library: Path
    variables: dict[str, str]


def compiled(name: str, folder: Path) -> Path:
    """The library of `name`.c, in `folder`. Raises CalledProcessError where cc does."""
    source, library = Path(__file__).with_name(f"{name}.c"), folder / f"{name}.so"
    subprocess.run([str(COMPILER), *OPTIONS, "-o", str(library), str(source)], check=True)
    return library


def launcher(*libraries: Preloaded) -> tuple[str, ...]:
    """What goes before a command that shall have them."""
    variables = {name: value for one in libraries for name, value in one.variables.items()}
    loaded = ":".join(str(one.library) for one in libraries)
    return ("env", f"LD_PRELOAD={loaded}", *(f"{name}={value}" for name, value in variables.items()))


class SteppedWallClock:
    """A wall clock that is stepped while processes read it; their monotonic clocks are right."""

    def __init__(self, folder: Path) -> None:
        """The library and the step are kept in `folder`. Raises CalledProcessError if cc does."""
        self._step = folder / "clock_step"
        self._step.write_bytes(struct.pack("q", 0))
        self.library = compiled("stepped_clock", folder)
        self.variables = {"STEPPED_CLOCK": str(self._step)}

    def step(self, seconds: int) -> None:
        """It is off by so much from now on."""
        with self._step.open("r+b") as step:
            step.write(struct.pack("q", seconds))
