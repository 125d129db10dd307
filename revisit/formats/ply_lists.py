"""Where the variable-length rows of a binary PLY element end, with every read checked."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from revisit.core.errors import MalformedBody


def rows_end(body: memoryview, start: int, rows: int, layout: list[tuple[int, int]], *, big_endian: bool) -> int:
    """The offset in `body` after `rows` rows from `start`.

    `layout` has (bytes of the list length or 0 for a scalar, bytes of an item) per property. A length is read as
    unsigned, so a negative one is too long. Raises MalformedBody where a row passes the end of `body`.
    """
    end = int(_rows_end(np.frombuffer(body, dtype=np.uint8), start, rows, np.array(layout, dtype=np.int64), big_endian))
    if end < 0:
        raise MalformedBody("a PLY list is longer than the body")
    return end


@njit(nogil=True, cache=True)
def _rows_end(body: NDArray[np.uint8], start: int, rows: int, layout: NDArray[np.int64], big_endian: bool) -> int:
    position = np.int64(start)
    for _ in range(rows):
        for index in range(len(layout)):
            width = layout[index, 0]
            length = np.int64(1)
            if width > 0:
                if position + width > len(body):
                    return -1
                length = np.int64(0)
                for step in range(width):
                    shift = 8 * (width - 1 - step) if big_endian else 8 * step
                    length |= np.int64(body[position + step]) << shift
                position += width
            position += length * layout[index, 1]
            if position > len(body):
                return -1
    return int(position)
