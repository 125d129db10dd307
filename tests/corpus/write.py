"""The files of the corpus: `python -m tests.corpus.write` makes the small ones, which are committed."""

from __future__ import annotations

import functools
from pathlib import Path

from tests.corpus.clouds import Bodies, cloud_bodies
from tests.corpus.requests import request_bodies

FILES = Path(__file__).parent / "files"

COMMITTED_BYTES = 16 * 2**10
"""A larger file is made when a test needs it."""


@functools.cache
def bodies() -> Bodies:
    """What makes each file, by name."""
    return {**cloud_bodies(), **request_bodies()}


@functools.cache
def body_of(name: str) -> bytes:
    """The file as it is committed, else as it is made."""
    committed = FILES / name
    return committed.read_bytes() if committed.exists() else bodies()[name]()


def write_files() -> int:
    """Make the small files anew and remove what is no longer of the corpus; how many there are."""
    FILES.mkdir(exist_ok=True)
    for file in FILES.iterdir():
        file.unlink()
    made = {name: build() for name, build in bodies().items()}
    small = {name: data for name, data in made.items() if len(data) <= COMMITTED_BYTES}
    for name, data in small.items():
        (FILES / name).write_bytes(data)
    return len(small)


if __name__ == "__main__":
    print(write_files(), "files")
