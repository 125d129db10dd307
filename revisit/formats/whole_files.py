"""Files that have their name once they are whole: one that was cut off in its middle cannot be taken for whole."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def written_beside(path: Path) -> Iterator[Path]:
    """A path to write a file to, which gets the name `path` at the end of the block, and is deleted where that fails.

    A link is followed. What is no file, such as a pipe, is written to as it is. Raises OSError.
    """
    if path.exists() and not path.is_file():
        yield path
        return
    target = path.resolve()
    part = target.with_name(f"{target.name}.part")
    try:
        yield part
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)


def write_whole(path: Path, content: bytes | str) -> None:
    """Write a file; text as UTF-8. Raises OSError."""
    data = content.encode() if isinstance(content, str) else content
    with written_beside(path) as part:
        part.write_bytes(data)
