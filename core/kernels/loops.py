"""How the loops of the kernels are compiled (docs/decisions/0111, 0177)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

_Kernel = TypeVar("_Kernel", bound=Callable[..., Any])


def loop(kernel: _Kernel) -> _Kernel:
    """Compiles a function that fills arrays it is given and makes none, without the counting of references.

    Numba counts references to an array wherever one gets another name, as the arguments of inlined functions do, by an
    instruction that locks the memory bus: at each step of a loop that took more time than the search for a neighbour. A
    function compiled so cannot leak, because it owns nothing; one that makes an array is refused by the compiler.
    """
    options: dict[str, Any] = {"cache": True, "error_model": "numpy", "_nrt": False}  # the last is not in its stubs
    return cast(_Kernel, numba.njit(**options)(kernel))
