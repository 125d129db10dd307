"""How the loops of the kernels are compiled (docs/decisions/0111, 0289, 0342)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.extending import register_jitable

from revisit.core.kernels.processor import choose_processor

choose_processor()

Function = TypeVar("Function", bound=Callable[..., Any])

_KEPT: dict[str, Any] = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_OPTIONS: dict[str, Any] = {"_nrt": False, **_KEPT}
_ANY_ORDER = {"reassoc", "contract"}


def compiled(function: Function) -> Function:
    """Compiles a function that makes arrays."""
    return cast(Function, numba.njit(**_KEPT)(function))


def fast(function: Function) -> Function:
    """As `compiled`; rounding is left to the compiler."""
    return cast(Function, numba.njit(fastmath=True, **_KEPT)(function))


def loop(function: Function) -> Function:
    """Compiles a function that fills arrays it is given and makes none, without the counting of references.

    Numba counts references to an array wherever one gets another name, as the arguments of inlined functions do, by an
    instruction that locks the memory bus: in the search for neighbours that took two fifths of the time. A function
    compiled so cannot leak, because it owns nothing; one that makes an array is refused by the compiler.
    """
    return cast(Function, numba.njit(**_OPTIONS)(function))


def sums(function: Function) -> Function:
    """As `loop`; the order of sums is left to the compiler, so that it adds several numbers at once."""
    return cast(Function, numba.njit(fastmath=_ANY_ORDER, **_OPTIONS)(function))


def inner(function: Function) -> Function:
    """As `loop`, for functions that only loops call: without a Python wrapper, a sixth of the compiler's work.

    From Python it runs as it is written.
    """
    return register_jitable(**_OPTIONS)(function)


def inner_sums(function: Function) -> Function:
    """As `inner` and `sums`."""
    return register_jitable(fastmath=_ANY_ORDER, **_OPTIONS)(function)


def inlined(function: Function) -> Function:
    """As `inner`, made a part of each loop that calls it: for the work of each turn.

    It keeps its own rounding. What is to be rounded as the `fast` loop around it is inlined by numba itself
    (`inline="always"`).
    """
    return register_jitable(forceinline=True, **_OPTIONS)(function)
