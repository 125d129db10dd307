"""Rows of numbers of which a column of a version is made."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import DataLoss


def packed_rows(data: bytes | None, kind: np.dtype[Any], **below: int) -> NDArray[Any]:
    """The rows of a `kind` in stored bytes, none of None; each field that is named must be below a number.

    Raises DataLoss where the bytes are of no such rows.
    """
    if len(data or b"") % kind.itemsize:
        raise DataLoss("the poses or verdicts of a version of the map are damaged")
    rows: NDArray[Any] = np.frombuffer(data or b"", kind)
    for name, bound in below.items():
        if (rows[name] >= bound).any():
            raise DataLoss("the verdicts of a version of the map are damaged")
    return rows
