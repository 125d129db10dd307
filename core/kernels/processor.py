"""The processor that kernels are compiled for (docs/decisions/0342): one that most machines are, so that code which was
compiled elsewhere is loaded and not compiled again.

`NUMBA_CPU_NAME` in the environment names another, `NUMBA_CPU_NAME=host` the machine's own.
"""

from __future__ import annotations

import platform
from typing import Any

from llvmlite import binding
from numba.core import config

COMMON = "x86-64-v3"
"""Since Intel's Haswell of 2013 and AMD's Excavator of 2015."""

_SETTINGS: Any = config
_ASKED = str(_SETTINGS.CPU_NAME or "")
"""The name in the environment, as numba has read it."""

_NEEDED = ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")


def choose_processor() -> str:
    """Have numba compile for the common processor where this one can run its code; the name of the choice.

    To be called before the first kernel is compiled or loaded.
    """
    if _ASKED == "host":
        _SETTINGS.CPU_NAME = None
    elif not _ASKED and _is_common():
        _SETTINGS.CPU_NAME, _SETTINGS.CPU_FEATURES = COMMON, ""
    return _SETTINGS.CPU_NAME or str(binding.get_host_cpu_name())


def _is_common() -> bool:
    features = binding.get_host_cpu_features()
    return platform.machine() in ("x86_64", "AMD64") and all(features.get(name) for name in _NEEDED)
