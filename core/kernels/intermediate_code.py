"""Intermediate code of kernels from the compiler's cache, which is hardly ever needed (docs/decisions/0289)."""

from __future__ import annotations

import gc
from functools import partial
from typing import Any

from llvmlite import binding
from numba.core.dispatcher import Dispatcher


def pack_intermediate_code() -> int:
    """Keep the intermediate code of all loaded kernels as bytes; how many were packed.

    Beside the machine code, which runs, each kernel holds the code that another one would be compiled with if it called
    the first: a tree of objects, many times as large as its bytes, of which it is made again when that happens. What
    this process compiled by itself stays as it is, and so does all where numba keeps it in another way.
    """
    kernels: list[Any] = [one for one in gc.get_objects() if isinstance(one, Dispatcher)]
    compiled = [one._asdict() for kernel in kernels for one in kernel.overloads.values()]
    return sum(_packed(one["library"]) for one in compiled)


def _packed(library: Any) -> bool:
    module = getattr(library, "_shared_module", None)
    if module is None or not hasattr(library, "_get_module_for_linking"):
        return False
    library._get_module_for_linking = partial(binding.parse_bitcode, module.as_bitcode())
    library._shared_module = None
    return True
