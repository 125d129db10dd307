"""Where numba keeps compiled kernels: beside the code where that can be written to, else in the service's home.

A process that has compiled keeps the compiler's memory, some 350 MB, for as long as it lives. So it starts anew.
"""

from __future__ import annotations

import gc
import os
import sys
from pathlib import Path

from revisit import core

CACHE_VARIABLE = "NUMBA_CACHE_DIR"

STARTED_ANEW = "REVISIT_KERNELS_COMPILED"
"""The environment of a process that has started anew: where nothing can be kept, it compiles and goes on."""


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


def begin_anew_if_compiled() -> None:
    """Replace this process by a fresh one of the same command, once, where it has compiled kernels itself.

    Those that it has loaded do not count. The process keeps its id and its parent.
    """
    if STARTED_ANEW not in os.environ and _has_compiled():
        os.execve(sys.executable, sys.orig_argv, {**os.environ, STARTED_ANEW: "1"})


def _has_compiled() -> bool:
    numba = sys.modules.get("numba.core.dispatcher")
    if numba is None:
        return False
    kernels = (one for one in gc.get_objects() if issubclass(type(one), numba.Dispatcher))
    return any(kernel.stats.cache_misses for kernel in kernels)
