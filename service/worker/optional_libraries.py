"""What libraries of a worker load where it is installed, though a worker never uses it (docs/decisions/0289)."""

from __future__ import annotations

import sys
from typing import Any

OPTIONAL = ("rich", "cffi", "charset_normalizer")
"""Coloured tracebacks of structlog, C functions that kernels could call for numba, guessed encodings for numpy.f2py."""


def leave_out_optional_libraries() -> None:
    """Let them be as if they were not installed, which who asks for them can bear. To be called before all imports."""
    modules: dict[str, Any] = sys.modules
    for name in OPTIONAL:
        modules.setdefault(name, None)
