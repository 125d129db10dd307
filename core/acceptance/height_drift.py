"""Whether poses of two drives lie on different storeys, or odometry has drifted in height between them.

The turns of a ramp and the storeys of a garage lie 2.5 to 4 m above each other, often after less way than a poor
odometry drifts so far in. How well the two odometries agree in height is seen in the loops themselves: where both
drives go on together, in neighbouring loops (docs/decisions/0214).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_REGISTRATION_M = 1.0
"""So far apart in height two right loops may put one query where nothing has drifted."""

_LEAST_DRIFT = 0.003
_DRIFTS = 3.0  # times the median of neighbouring loops
_NEIGHBOURS_M = 10.0, 30.0
_ONE_STOREY_M = 1.5
_LEAST_PAIRS = 10
_UNKNOWN_DRIFT = 1.0


def allowed_rises_m(way_m: Array, drift: float) -> Array:
    """So far apart in height may two right loops put a query after so much way, metres; `drift` by `height_drift`."""
    return np.asarray(_REGISTRATION_M + drift * way_m)


def height_drift(rise_m: Array, way_m: Array) -> float:
    """How far in height odometry may have drifted a metre of way; as far as that where too few loops tell.

    `rise_m` (n, n): how far apart in height each loop (second) and that of the query itself (first) put the query of
    each; `way_m` (n, n): the way of both drives over which odometry carries one to the other.
    """
    together = (way_m >= _NEIGHBOURS_M[0]) & (way_m <= _NEIGHBOURS_M[1]) & (rise_m < _ONE_STOREY_M)
    if together.sum() < _LEAST_PAIRS:
        return _UNKNOWN_DRIFT
    return max(_LEAST_DRIFT, _DRIFTS * float(np.median(rise_m[together] / way_m[together])))
