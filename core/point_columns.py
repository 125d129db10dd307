"""The columns of a point beside its coordinates: one table of their names, types, ranges and forms.

Recordings, the SDK, the service and exports carry them; places rest on none (decision 0355).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField

Columns: TypeAlias = Mapping[str, NDArray[Any]]
"""The values of points by the name of the column: (n,), or (n, channels) of a column with several."""

NONE: Columns = MappingProxyType({})
"""Of points that have coordinates alone."""

NS_A_TIME_STEP = 1000


@dataclass(frozen=True)
class PointColumn:
    """A column. Values of `kind` (numpy, without byte order) are from `low` to `high`, in `unit`; (n, channels) of more
    than one channel.

    On the wire a value is a whole number of steps in `coded_bytes` bytes; `step` None is a share of the largest value.
    `missing` stands for a value that is not known; None where no value can.
    """

    name: str
    kind: str
    low: int
    high: int
    unit: str
    coded_bytes: int
    step: int | None = 1
    channels: int = 1
    missing: int | None = None

    def validated(self, values: NDArray[Any], points: NDArray[np.floating]) -> NDArray[Any]:
        """The values of the finite ones of the points (n, 3), of all of which they are given.

        Raises BadField for another shape, and for values that are not finite, out of range, or no whole numbers.
        """
        self.require_shape(values, len(points))
        finite = np.isfinite(points).all(axis=1)
        kept = values if finite.all() else values[finite]
        if not self.holds(kept):
            kind = "finite" if self.kind.startswith("f") else "whole numbers"
            raise BadField(f"{self.name} must be {self.low:,} to {self.high:,}, and {kind}", field=self.name)
        return np.ascontiguousarray(kept, dtype=self.kind)

    def require_shape(self, values: NDArray[Any], count: int) -> None:
        """Raises BadField for values that are not those of so many points."""
        shape = (count,) if self.channels == 1 else (count, self.channels)
        if values.shape != shape:
            raise BadField(f"{self.name} must be {shape}, got {values.shape}", field=self.name)

    def holds(self, values: NDArray[Any]) -> bool:
        """Whether all values are numbers in the range, and whole where the column has whole numbers."""
        if values.dtype.kind not in "biuf":
            return False
        if not ((values >= self.low) & (values <= self.high)).all():
            return False
        whole = self.kind.startswith("f") or values.dtype.kind != "f"
        return whole or bool((values == np.rint(values)).all())


INTENSITY = PointColumn("intensity", "f4", 0, 65_535, "that of the sensor", 2, step=None, missing=0)
"""Of a return: 0 to 1, 0 to 255, or 16 bits."""

RING = PointColumn("ring", "u2", 0, 65_535, "number of the laser within its sensor", 2)

TIME = PointColumn("time", "i4", -2_000_000_000, 2_000_000_000, "ns since the stamp of the scan", 4, NS_A_TIME_STEP)
"""When the return was measured; on the wire to a microsecond. Deskewing moves the point and keeps its time."""

RGB = PointColumn("rgb", "u1", 0, 255, "red, green, blue", 1, channels=3)

COLUMNS = {one.name: one for one in (INTENSITY, RING, TIME, RGB)}
"""By name, in the order in which they are coded."""

USUAL = (INTENSITY.name,)
"""The columns that are read of clouds where nobody names others."""


def column(name: str) -> PointColumn:
    """The column with that name. Raises BadField where there is none."""
    if name not in COLUMNS:
        raise BadField(f"the columns of a point are {', '.join(COLUMNS)}, not {name[:40]!r}", field="columns")
    return COLUMNS[name]


def validated(columns: Columns, points: NDArray[np.floating]) -> Columns:
    """The columns of the finite ones of the points (n, 3), in order. Raises BadField as `column`, `validated` do."""
    for name in columns:
        column(name)
    return {name: one.validated(columns[name], points) for name, one in COLUMNS.items() if name in columns}


def usable(columns: Columns, points: NDArray[np.floating]) -> Columns:
    """Those of the columns that are valid and not 0 everywhere, which tells nothing, of the finite points."""
    found = dict[str, NDArray[Any]]()
    for name, values in columns.items():
        try:
            if values.any():
                found[name] = column(name).validated(values, points)
        except BadField:
            continue
    return found


def at_rows(columns: Columns, rows: NDArray[Any] | slice) -> Columns:
    """The columns of some of the points: rows by number, or a mask."""
    return {name: values[rows] for name, values in columns.items()}


def only(columns: Columns, names: Collection[str]) -> Columns:
    """Those of the columns that are named."""
    return {name: values for name, values in columns.items() if name in names}


def joined(parts: Sequence[Columns]) -> Columns:
    """The columns of clouds one after the other: those that all have."""
    shared = [name for name in COLUMNS if parts and all(name in part for part in parts)]
    return {name: np.concatenate([part[name] for part in parts]) for name in shared}


def same(first: Columns, second: Columns) -> bool:
    """Whether two clouds have the same columns with the same values."""
    if first.keys() != second.keys():
        return False
    return all(np.array_equal(first[name], second[name], equal_nan=True) for name in first)
