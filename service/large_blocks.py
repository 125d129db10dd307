"""Memory that is free goes back to the system: of large blocks at once, of everything when asked."""

from __future__ import annotations

import ctypes

LARGE_BYTES = 4 * 2**20

KEPT_BYTES = 8 * 2**20
"""So much free memory at the end of a heap is kept: the next scan uses that of the last, without page faults."""

SPARE_BYTES = 12 * 2**20
"""So much at the end of the heap is kept between two jobs of a worker: any description takes more."""

_M_MMAP_THRESHOLD = -3
_M_TRIM_THRESHOLD = -1
_M_ARENA_MAX = -8


def return_large_blocks(kept_bytes: int = KEPT_BYTES) -> None:
    """Let the allocator map blocks of `LARGE_BYTES` and more by themselves; `kept_bytes` may be free at a heap's end.

    glibc raises this threshold up to 32 MiB as soon as such a block is freed, and then keeps large messages in its
    heaps, which give little back. Another C library has no such function, and no such habit.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, LARGE_BYTES)
        mallopt(_M_TRIM_THRESHOLD, kept_bytes)


def share_one_heap() -> None:
    """Let all threads of this process take memory from one heap, where each would get one of its own.

    Those of a worker read, write and beat for the one that works, and the freed memory of each lay idle until the next
    return. To be called before they begin. Another C library has no such function.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_ARENA_MAX, 1)


def return_free_memory() -> None:
    """Give back the pages that nothing lies in, also those between blocks that are in use; `SPARE_BYTES` are kept.

    Returned pages are faulted in again when they are next needed. Another C library has no such function.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(ctypes.c_size_t(SPARE_BYTES))
