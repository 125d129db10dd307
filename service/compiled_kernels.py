"""Where numba keeps compiled kernels: beside the code where that can be written to, else in the service's home."""

from __future__ import annotations

import os
from pathlib import Path

from revisit import core

CACHE_VARIABLE = "NUMBA_CACHE_DIR"


def choose_cache(home: Path) -> Path | None:
    """Name a folder under `home` to numba where the code's own folder is read-only; that folder, None for no need.

    An installation that the service may not write to, run by a user without a home directory, leaves numba no place
    at all, and then it refuses to compile. To be called before numba is imported; a folder that was chosen stays.
    """
    if os.environ.get(CACHE_VARIABLE) or _writable(Path(core.__file__).resolve().parent / "kernels"):
        return None
    folder = home.absolute() / "compiled-kernels"
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    os.environ[CACHE_VARIABLE] = str(folder)
    return folder


def _writable(code: Path) -> bool:
    """Whether numba can write where it does first: into `__pycache__` beside the code."""
    cached = code / "__pycache__"
    return os.access(cached if cached.exists() else code, os.W_OK | os.X_OK)
