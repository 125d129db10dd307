"""Range images of all scans at once, and which positions they were looked through, by torch (Eq. 6)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from lab.gpu.order import root
from lab.gpu.replay import replayed
from revisit.core.kernels.arcs import SERIES_32
from revisit.core.kernels.visibility import COLUMNS, FARTHER, MARGIN_M, PIXELS_PER_RADIAN, ROWS

_HALF_TURN, _QUARTER_TURN, _TINY = (float(np.float32(value)) for value in (np.pi, 0.5 * np.pi, 1e-30))
_INFINITE = float("inf")


@replayed
def pixels_of(rays: Tensor) -> tuple[Tensor, Tensor]:
    """The pixels (n,) and ranges (n,) of `rays` (n, 3) float32 from the sensor."""
    x, y, z = rays.unbind(-1)
    level = x * x + y * y
    per_radian = float(PIXELS_PER_RADIAN)
    column = ((_arc_tangent(y, x) + _HALF_TURN) * per_radian).int()
    row = ((_arc_tangent(z, root(level)) + _QUARTER_TURN) * per_radian).int().clamp(max=ROWS - 1)
    pixels = row * COLUMNS + torch.where(column < COLUMNS, column, 0)
    return pixels.long(), root(level + z * z)


def range_images(pixels: Tensor, measured: Tensor, scans: Tensor, count: int) -> Tensor:
    """The smallest range in each pixel of each scan: (scans, rows, columns); infinite where nothing was measured."""
    size = ROWS * COLUMNS
    images = torch.full((count * size,), _INFINITE, device=pixels.device)
    return images.scatter_reduce(0, scans * size + pixels, measured, "amin").reshape(count, ROWS, COLUMNS)


def nearest_around(images: Tensor) -> Tensor:
    """As `kernels.visibility._nearest_around` of each scan: (scans, rows * columns)."""
    wide = torch.cat([images[..., -1:], images, images[..., :1]], dim=2)
    padded = torch.nn.functional.pad(wide, (0, 0, 1, 1), value=_INFINITE)
    windows = padded.unfold(1, 3, 1).unfold(2, 3, 1).flatten(3)
    least, measured = windows.amin(3), (windows < _INFINITE).sum(3)
    return torch.where(measured >= 2, least, 0.0).flatten(1)


def seen_through(rays: Tensor, nearest: Tensor) -> Tensor:
    """How many scans (n,) int32 looked through positions at `rays` (scans, n, 3) from them."""
    pixels, away = (part.reshape(rays.shape[:2]) for part in pixels_of(rays.reshape(-1, 3)))
    beyond = nearest.gather(1, pixels) > away * float(FARTHER) + float(MARGIN_M)
    return beyond.sum(0, dtype=torch.int32)


def _arc_tangent(y: Tensor, x: Tensor) -> Tensor:
    """As `kernels.arcs.arc_tangent_32`, step by step: a pixel's edge must not move."""
    wide, high = x.abs(), y.abs()
    ratio = torch.minimum(wide, high) / (torch.maximum(wide, high) + _TINY)
    z = ratio * ratio
    series = torch.full_like(z, float(SERIES_32[-1]))
    for factor in SERIES_32[-2::-1]:
        series = float(factor) + z * series
    angle = ratio + ratio * z * series
    angle = torch.where(high > wide, _QUARTER_TURN - angle, angle)
    angle = torch.where(x < 0.0, _HALF_TURN - angle, angle)
    return torch.where(y < 0.0, -angle, angle)
