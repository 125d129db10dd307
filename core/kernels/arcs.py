"""Angles fast enough for every return of a submap: right within 2e-8 radians, or 4e-7 in 32 bits."""

from __future__ import annotations

import numpy as np

from revisit.core.kernels.loops import inlined

_A2, _A4, _A6, _A8 = -0.3333314528, 0.1999355085, -0.1420889944, 0.1065626393
_A10, _A12, _A14, _A16 = -0.0752896400, 0.0429096138, -0.0161657367, 0.0028662257


@inlined
def arc_tangent(y: float, x: float) -> float:
    """The angle of (x, y) in (-pi, pi] radians; 0 for the origin. Source: Abramowitz and Stegun, 4.4.49."""
    wide, high = abs(x), abs(y)
    ratio = (wide if wide < high else high) / ((high if wide < high else wide) + 1e-300)
    z = ratio * ratio
    series = _A2 + z * (_A4 + z * (_A6 + z * (_A8 + z * (_A10 + z * (_A12 + z * (_A14 + z * _A16))))))
    angle = ratio + ratio * z * series
    angle = 0.5 * np.pi - angle if high > wide else angle
    angle = np.pi - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


SERIES_32 = tuple(np.float32(value) for value in (_A2, _A4, _A6, _A8, _A10, _A12, _A14, _A16))
_TINY, _QUARTER, _HALF = np.float32(1e-30), np.float32(0.5 * np.pi), np.float32(np.pi)


@inlined
def arc_tangent_32(y: np.float32, x: np.float32) -> np.float32:
    """As `arc_tangent`, of 32-bit numbers, of which a processor does twice as many at once."""
    wide, high = abs(x), abs(y)
    ratio = (wide if wide < high else high) / ((high if wide < high else wide) + _TINY)
    z = ratio * ratio
    series = SERIES_32[4] + z * (SERIES_32[5] + z * (SERIES_32[6] + z * SERIES_32[7]))
    series = SERIES_32[0] + z * (SERIES_32[1] + z * (SERIES_32[2] + z * (SERIES_32[3] + z * series)))
    angle = ratio + ratio * z * series
    angle = _QUARTER - angle if high > wide else angle
    angle = _HALF - angle if x < np.float32(0.0) else angle
    return -angle if y < np.float32(0.0) else angle
