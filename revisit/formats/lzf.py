"""LZF, the compression inside `DATA binary_compressed` of PCD, decoded with every read and write checked."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from revisit.core.errors import MalformedBody

# A back-reference of 3 bytes yields at most 264: nothing can be compressed better than that.
MAX_RATIO = 88


def decompress(data: memoryview, size: int) -> memoryview:
    """The `size` bytes that `data` decodes to. Raises MalformedBody unless it decodes to exactly that many."""
    if size > len(data) * MAX_RATIO:
        raise MalformedBody(f"{len(data)} LZF bytes cannot hold {size}")
    output = np.zeros(size, dtype=np.uint8)
    if _decompress(np.frombuffer(data, dtype=np.uint8), output) != size:
        raise MalformedBody("the LZF data is damaged or does not have the declared size")
    return output.data


@njit(nogil=True, cache=True)
def _decompress(source: NDArray[np.uint8], target: NDArray[np.uint8]) -> int:
    """Bytes written, or -1 where the stream reads or writes outside of its buffers."""
    read = np.int64(0)
    written = np.int64(0)
    while read < len(source):
        control = np.int64(source[read])
        read += 1
        if control < 32:
            length = control + np.int64(1)
            if read + length > len(source) or written + length > len(target):
                return -1
            for step in range(length):
                target[written + step] = source[read + step]
            read += length
        else:
            length = control >> 5
            if length == 7:
                if read >= len(source):
                    return -1
                length += np.int64(source[read])
                read += 1
            if read >= len(source):
                return -1
            start = written - ((control & 31) << 8) - np.int64(source[read]) - 1
            read += 1
            length += 2
            if start < 0 or written + length > len(target):
                return -1
            for step in range(length):
                target[written + step] = target[start + step]
        written += length
    return int(written)
