"""Optional imports of a worker's libraries that a worker never uses (docs/decisions/0289)."""

from __future__ import annotations

import sys
from typing import Any

OPTIONAL = ("rich", "cffi", "charset_normalizer")
"""Coloured tracebacks of structlog, C functions that kernels could call for numba, guessed encodings for numpy.f2py."""


def leave_out_optional_libraries() -> None:
    """Hide them, as if they were not installed: their importers can bear that. To be called before all imports."""
    modules: dict[str, Any] = sys.modules
    for name in OPTIONAL:
        modules.setdefault(name, None)
