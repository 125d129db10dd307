"""When each point of a sweep was taken, as drivers of spinning and solid-state LiDARs write it beside the point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.point_columns import TIME, Columns
from revisit.formats.pointcloud2 import PackedCloud, columns_of_points

SHORTEST_SWEEP_NS, LONGEST_SWEEP_NS = 2_000_000, 1_000_000_000
"""Times that spread by less or more are not believed to be those of one sweep."""

_UNITS_NS = (1e9, 1e6, 1e3, 1.0)


def point_offsets(packed: PackedCloud, stamp_ns: int) -> NDArray[np.int64] | None:
    """The times (n,) of the points since `stamp_ns`, nanoseconds; None where no field tells them."""
    return offsets_of(columns_of_points(packed, (TIME.name,)), stamp_ns)


def offsets_of(columns: Columns, stamp_ns: int) -> NDArray[np.int64] | None:
    """The times (n,) since `stamp_ns`, nanoseconds, of the column of times as a file has it; None where it tells none.

    Whole numbers are nanoseconds; the unit of others is that in which they spread as a sweep does. They count from the
    stamp, or from where the stamp does. A point whose time cannot be one of the sweep has that of the stamp.
    """
    given = columns.get(TIME.name)
    if given is None or len(given) == 0:
        return None
    values = given.astype(np.float64)
    for unit_ns in _UNITS_NS if given.dtype.kind == "f" else _UNITS_NS[-1:]:
        for origin_ns in (0, stamp_ns):
            found = _of_a_sweep(values * unit_ns - origin_ns)
            if found is not None:
                return found
    return None


def timed(columns: Columns, stamp_ns: int) -> Columns:
    """The columns as a file has them, with times as a scan of that stamp has them; without where they tell none."""
    offsets = offsets_of(columns, stamp_ns)
    others = {name: values for name, values in columns.items() if name != TIME.name}
    return others if offsets is None else {**others, TIME.name: offsets}


def _of_a_sweep(offsets_ns: NDArray[np.float64]) -> NDArray[np.int64] | None:
    """The times (n,) of a sweep; None where these are none."""
    near = np.abs(offsets_ns) <= LONGEST_SWEEP_NS
    if 2 * near.sum() < len(near):
        return None
    spread = float(np.ptp(offsets_ns[near]))
    if not SHORTEST_SWEEP_NS <= spread <= LONGEST_SWEEP_NS:
        return None
    return np.where(near, offsets_ns, 0.0).astype(np.int64)
