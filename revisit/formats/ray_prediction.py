"""The expected point of a scan, by the two before it: neighbours on a ring lie on neighbouring rays.

The error of a LiDAR lies along the ray, so once one coordinate of a point is known, its ray tells the others. All
numbers are integers, steps of a grid. With `a` the horizontal coordinate that was the larger one at the point before
(x, if they are equal), `b` the other one, and `c` either `b` or z, a point (a, c) after (a1, c1) after (a2, c2) is
expected at

    DIFFERENCE  c1
    ON_RAY      p1 = round(c1 a / a1), or c1 where a1 = 0 or |p1| > 2^30
    TURNED      2 p1 - p2, p2 = round(c2 a / a2), or p1 where a2 = 0 or |p1 - p2| > floor(|a| / 16)

round(n / m) is floor((n + floor(m / 2)) / m) with m > 0. What is before the first point is zero. Coordinates are at
most 2^24, so products are exact in float64, and so is the floor of their quotient.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

Column = NDArray[np.float64]

MAX_STEPS = 2**24
"""The largest coordinate, in steps of the grid."""
MAX_EXPECTED = 2**30
"""The largest coordinate that is expected along a ray, in steps."""
_SAMPLED = 8  # every so many-th point tells which prediction is best
_AT_ONCE = 8192  # points whose columns fit into a processor's cache: page faults took half of the time


class Prediction(IntEnum):
    """How a coordinate is expected from those of the two points before."""

    DIFFERENCE = 0
    ON_RAY = 1
    TURNED = 2


def residuals(grid: NDArray[np.float64]) -> tuple[list[Column], Prediction, Prediction]:
    """Residuals of points (n, 3) of whole numbers against the expected ones: columns a, b and z, each (n,).

    And how b and z are expected: whichever leaves least.
    """
    axes = [_Followed.of(column) for column in grid.T]
    a, b, z = _led([axis[::_SAMPLED] for axis in axes])
    of_side, of_height = _best(a, b), _best(a, z)
    columns = [np.empty(len(grid)) for _ in range(3)]
    for start in range(0, len(grid), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        a, b, z = _led([axis[some] for axis in axes])
        columns[0][some] = a.now - a.first
        columns[1][some] = b.now - _expected(of_side, a, b)
        columns[2][some] = z.now - _expected(of_height, a, z)
    return columns, of_side, of_height


@dataclass(frozen=True)
class _Followed:
    """A coordinate of each point (n,), of the point before, and of the one before that."""

    now: Column
    first: Column
    second: Column

    @classmethod
    def of(cls, column: Column) -> _Followed:
        before = np.concatenate([np.zeros(2), column])
        return cls(before[2:], before[1:-1], before[:-2])

    def where(self, own: NDArray[np.bool_], other: _Followed) -> _Followed:
        return _Followed(
            np.where(own, self.now, other.now),
            np.where(own, self.first, other.first),
            np.where(own, self.second, other.second),
        )

    def __getitem__(self, rows: slice) -> _Followed:
        return _Followed(self.now[rows], self.first[rows], self.second[rows])


def _led(axes: list[_Followed]) -> tuple[_Followed, _Followed, _Followed]:
    """x, y and z as a, b and z."""
    x, y, z = axes
    x_leads = np.abs(x.first) >= np.abs(y.first)
    return x.where(x_leads, y), y.where(x_leads, x), z


def _best(a: _Followed, c: _Followed) -> Prediction:
    bits = {how: float(np.log2(1.0 + np.abs(c.now - _expected(how, a, c))).sum()) for how in Prediction}
    return min(bits, key=bits.__getitem__)


def _expected(how: Prediction, a: _Followed, c: _Followed) -> Column:
    if how == Prediction.DIFFERENCE:
        return c.first
    on_ray = _quotient(c.first * a.now, a.first)
    on_ray = np.where((a.first == 0) | (np.abs(on_ray) > MAX_EXPECTED), c.first, on_ray)
    if how == Prediction.ON_RAY:
        return on_ray
    turned = on_ray - _quotient(c.second * a.now, a.second)
    return np.where((a.second == 0) | (np.abs(turned) > np.floor(np.abs(a.now) / 16)), on_ray, on_ray + turned)


def _quotient(numerator: Column, denominator: Column) -> Column:
    """Rounded to the next integer; zero denominators count as one."""
    positive = np.maximum(np.abs(denominator), 1.0)
    half = np.floor(0.5 * positive)
    return np.floor((np.where(denominator < 0, -numerator, numerator) + half) / positive)
