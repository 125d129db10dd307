"""Files that have their name once they are whole: one that was cut off in its middle cannot be taken for whole."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

STREAMS = (Path("/dev"), Path("/proc"))
"""Folders of what is no file of its own: an open one, or a device."""

NAME_KEPT = 40
"""Characters of a file's name in that of the one beside it; names have 255 bytes at most."""


@contextmanager
def written_beside(path: Path) -> Iterator[Path]:
    """A path to write a file to, which gets the name `path` at the end of the block, and is deleted where that fails.

    It is nobody else's, and has the permissions of the file that it replaces. A link is followed. What is no file, such
    as a pipe, is written to as it is. Raises OSError, which names `path`.
    """
    if path.exists() and (not path.is_file() or any(folder in path.absolute().parents for folder in STREAMS)):
        yield path
        return
    target = path.resolve()
    part = target.with_name(f"{target.name[:NAME_KEPT]}.{secrets.token_hex(4)}.part")
    try:
        yield part
        if target.exists():
            part.chmod(target.stat().st_mode)
        part.replace(target)
    except OSError as error:
        if error.filename == str(part):
            error.filename = str(path)
        raise
    finally:
        part.unlink(missing_ok=True)


def write_whole(path: Path, content: bytes | str) -> None:
    """Write a file; text as UTF-8. Raises OSError."""
    data = content.encode() if isinstance(content, str) else content
    with written_beside(path) as part:
        part.write_bytes(data)
