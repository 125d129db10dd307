"""The columns of a quantised cloud, summed up in one pass: a service decodes every scan of every robot."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from revisit.formats.ray_prediction import MAX_EXPECTED, MAX_STEPS, Prediction

Bytes = NDArray[np.uint8]

_DIFFERENCE, _TURNED = int(Prediction.DIFFERENCE), int(Prediction.TURNED)


@njit(nogil=True, cache=True, error_model="numpy")
def coordinates_on_rays(
    planes: Bytes, count: int, step_m: float, of_side: int, of_height: int
) -> tuple[NDArray[np.float32], bool]:
    """Points (count, 3) in metres of three columns of what differs from what is expected (`ray_prediction.residuals`).

    And whether all coordinates are at most `MAX_STEPS`; where one is not, the points are worth nothing.
    """
    points = np.empty((count, 3), dtype=np.float32)
    a1 = b1 = z1 = a2 = b2 = z2 = 0.0  # whole numbers, exact
    x_led = True
    for row in range(np.uint64(count)):
        x_leads = abs(a1) >= abs(b1) if x_led else abs(b1) >= abs(a1)
        if x_leads != x_led:
            a1, b1, a2, b2 = b1, a1, b2, a2
            x_led = x_leads
        a = a1 + _coded(planes, 0, row, count)
        if abs(a) > MAX_STEPS:
            return points, False
        b = _expected(of_side, a, a1, b1, a2, b2) + _coded(planes, 1, row, count)
        z = _expected(of_height, a, a1, z1, a2, z2) + _coded(planes, 2, row, count)
        if abs(b) > MAX_STEPS or abs(z) > MAX_STEPS:
            return points, False
        points[row, 0] = (a if x_leads else b) * step_m
        points[row, 1] = (b if x_leads else a) * step_m
        points[row, 2] = z * step_m
        a1, b1, z1, a2, b2, z2 = a, b, z, a1, b1, z1
    return points, True


@njit(nogil=True, cache=True)
def levels(planes: Bytes, count: int, width: int) -> NDArray[np.uint32]:
    """Whole numbers (count,) of a column of zigzag-coded differences modulo 256^width: `width` byte planes of `count`.

    A width is 1, 2 or 4.
    """
    found = np.empty(count, dtype=np.uint32)
    mask = np.int64(2) ** np.int64(8 * width) - np.int64(1)
    total = np.int64(0)
    for row in range(np.uint64(count)):
        coded = np.uint32(0)
        for plane in range(np.uint64(width)):
            coded |= np.uint32(planes[plane * np.uint64(count) + row]) << np.uint32(np.uint64(8) * plane)
        total = (total + _unfolded(coded)) & mask
        found[row] = total
    return found


def warm_up() -> None:
    """Sum up a point, for the compiler's sake alone."""
    planes = np.frombuffer(bytes(14), dtype=np.uint8)
    coordinates_on_rays(planes, 1, 1.0, Prediction.DIFFERENCE, Prediction.DIFFERENCE)
    levels(planes[12:], 1, 2)


@njit(inline="always")
def _coded(planes: Bytes, column: int, row: int, count: int) -> float:
    """The difference in a row of a column of four byte planes."""
    first, size = np.uint64(4 * column * count) + np.uint64(row), np.uint64(count)
    low = np.uint32(planes[first]) | np.uint32(planes[first + size]) << np.uint32(8)
    high = np.uint32(planes[first + np.uint64(2) * size]) << np.uint32(16)
    return np.float64(_unfolded(low | high | np.uint32(planes[first + np.uint64(3) * size]) << np.uint32(24)))


@njit(inline="always")
def _expected(how: int, a: float, a1: float, c1: float, a2: float, c2: float) -> float:
    """Where a coordinate is expected, in steps: `ray_prediction`, for one point."""
    on_ray = c1
    if how != _DIFFERENCE and a1 != 0.0:
        on_ray = _quotient(c1 * a, a1)
        if abs(on_ray) > MAX_EXPECTED:
            on_ray = c1
    if how != _TURNED or a2 == 0.0:
        return on_ray
    turned = on_ray - _quotient(c2 * a, a2)
    return on_ray if abs(turned) > np.floor(0.0625 * abs(a)) else on_ray + turned


@njit(inline="always")
def _quotient(numerator: float, denominator: float) -> float:
    """Rounded to the next integer: exact, for the numerator has at most 48 bits."""
    if denominator < 0.0:
        numerator, denominator = -numerator, -denominator
    whole: float = np.floor((numerator + np.floor(0.5 * denominator)) / denominator)
    return whole


@njit(inline="always")
def _unfolded(coded: np.uint32) -> np.int32:
    """Zigzag: 2 d for d >= 0, else -2 d - 1. Its lowest bit says whether all others are to be turned."""
    return np.int32(coded >> np.uint32(1)) ^ -np.int32(coded & np.uint32(1))
