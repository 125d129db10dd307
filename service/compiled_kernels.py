"""Where numba keeps compiled kernels: beside the code where that can be written to, else in the service's home.

A process that has compiled keeps the compiler's memory, some 350 MB, for as long as it lives. So it starts anew.
"""

from __future__ import annotations

import gc
import hashlib
import os
import sys
from contextlib import suppress
from pathlib import Path

from revisit import core, formats

CACHE_VARIABLE = "NUMBA_CACHE_DIR"

_CODE = (Path(core.__file__).parent / "kernels", Path(formats.__file__).parent)
_FILES = "*.nb[ci]"
"""The folders with kernels, and the files of numba's cache in their `__pycache__`: see docs/decisions/0342."""

STARTED_ANEW = "REVISIT_KERNELS_COMPILED"
"""The environment of a process that has started anew: where nothing can be kept, it compiles and goes on."""


def choose_cache(home: Path) -> Path | None:
    """Name a folder under `home` to numba where the code's own folder is read-only; that folder, None for no need.

    An installation that the service may not write to, run by a user without a home directory, leaves numba no place
    at all, and then it refuses to compile. To be called before numba is imported; a folder that was chosen stays.
    Kernels that were shipped with the code are copied there.
    """
    asked = os.environ.get(CACHE_VARIABLE)
    if not asked and _writable(Path(core.__file__).resolve().parent / "kernels"):
        return None
    folder = Path(asked) if asked else home.absolute() / "compiled-kernels"
    if not asked:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        os.environ[CACHE_VARIABLE] = str(folder)
    with suppress(OSError):  # then they are compiled
        for code in _CODE:
            _bring(code, folder)
    return None if asked else folder


def _bring(code: Path, folder: Path) -> None:
    """Copy the kernels that were shipped beside `code` into a cache, once each time that others are shipped."""
    shipped = sorted((code / "__pycache__").glob(_FILES))
    if not shipped:
        return
    there = folder / cache_of(code)
    note = there / "shipped"
    listed = "".join(f"{path.name} {path.stat().st_size} {path.stat().st_mtime_ns}\n" for path in shipped)
    if note.is_file() and note.read_text() == listed:
        return
    there.mkdir(mode=0o700, parents=True, exist_ok=True)
    for path in shipped:
        _replace(there / path.name, path.read_bytes())
    _replace(note, listed.encode())


def cache_of(code: Path) -> str:
    """The folder of a chosen cache in which numba keeps the kernels of modules in `code`."""
    place = os.path.abspath(code)  # noqa: PTH100  # numba follows no links
    return f"{code.name}_{hashlib.sha1(place.encode(), usedforsecurity=False).hexdigest()}"


def _replace(path: Path, content: bytes) -> None:
    """Another process may read the file, or write it as well."""
    beside = path.with_name(f"{path.name}.{os.getpid()}")
    beside.write_bytes(content)
    beside.replace(path)


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
