"""`Drafts` in a folder of the data folder."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

from revisit.service.engines.local.files.disk import durable_write, make_directories


class FileDrafts:
    """One file a draft, named by the hash of its name."""

    def __init__(self, folder: Path) -> None:
        """`folder` is made at the first draft and removed with the last."""
        self._folder = folder

    def read(self, name: str) -> bytes | None:
        """See `Drafts`."""
        file = self._file(name)
        return file.read_bytes() if file.is_file() else None

    def write(self, name: str, data: bytes) -> None:
        """See `Drafts`."""
        make_directories(self._folder, self._folder.parent)
        durable_write(self._file(name), data, is_blob=False)

    def discard(self) -> None:
        """See `Drafts`."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _file(self, name: str) -> Path:
        return self._folder / hashlib.sha256(name.encode()).hexdigest()
