"""Phase correlation: how an image of a place's structure, turned and shifted, fits that of another one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from revisit.core.kernels.plan_images import plan_density

Array64 = NDArray[np.float64]
Spectrum = NDArray[np.complexfloating]


@dataclass(frozen=True)
class Agreement:
    """How well an image that was turned fits another one: the largest correlation over all shifts, divided by the norm
    of the turned image; the yaw; and the shift (2,), x and y in pixels.
    """

    peak: float
    yaw: float
    shift: Array64


def agreements(points: Array64, yaws: Sequence[float], spectrum: Spectrum, pixel: float) -> list[Agreement]:
    """For each of `yaws` the best shift, and that for half a turn more.

    points (n, 2) of structure, seen from above, metres; spectrum that of the other image, of edge `pixel` metres.
    """
    size, found = len(spectrum), []
    for yaw in yaws:
        image = plan_density(points, yaw, pixel, size)
        norm = max(float(np.linalg.norm(image)), 1e-12)
        turned = fft.rfft2(image.astype(np.float32))
        for half_turn in (False, True):
            peak, shift = best_shift(turned, spectrum, half_turn)
            found.append(Agreement(peak / norm, yaw + np.pi * half_turn, shift))
    return found


def best_shift(spectrum: Spectrum, other: Spectrum, half_turn: bool) -> tuple[float, Array64]:
    """The largest correlation of an image with the other, and the shift (x, y) in pixels that gives it.

    With `half_turn` the image is turned by 180 degrees first: its spectrum is then the conjugate, but for a pixel.
    """
    size, half = len(spectrum), len(spectrum) // 2
    surface = fft.irfft2(other * (spectrum if half_turn else np.conj(spectrum)), s=(size, size))
    row, column = np.unravel_index(int(surface.argmax()), surface.shape)
    shift = (np.array([column, row], dtype=np.float64) + half_turn + half) % size - half
    return float(surface[row, column]), shift
