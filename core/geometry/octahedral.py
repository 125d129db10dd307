"""Unit vectors as two small integers: the octahedron unfolded into a square."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

_LISTED_STEPS = 31
"""Up to so many steps the vectors of all codes are listed: at most 4,000."""


def encode(vectors: NDArray[np.floating], steps: int) -> NDArray[np.uint8]:
    """Codes (n, 2) in 0..2 * steps of unit vectors (n, 3); `steps` up to 127. The zero vector becomes +z."""
    x, y, z = np.ascontiguousarray(vectors.T)
    wide, deep = np.abs(x), np.abs(y)
    length = np.maximum(wide + deep + np.abs(z), 1e-12)
    below = z < 0.0
    lower = (1.0 - deep / length) * np.where(x >= 0.0, 1.0, -1.0), (1.0 - wide / length) * np.where(y >= 0.0, 1.0, -1.0)
    square = np.where(below, lower[0], x / length), np.where(below, lower[1], y / length)
    return np.stack([np.rint((side + 1.0) * steps) for side in square], axis=1).astype(np.uint8)


def decode(codes: NDArray[np.integer], steps: int) -> NDArray[np.float64]:
    """The unit vectors (n, 3) of codes (n, 2): within about 2 / steps radians of the encoded ones."""
    if steps > _LISTED_STEPS:
        return _decoded(codes, steps)
    return listed(steps).take(codes[:, 0].astype(np.int64) * (2 * steps + 1) + codes[:, 1], axis=0)


@lru_cache(maxsize=4)
def listed(steps: int) -> NDArray[np.float64]:
    """The unit vector of each code, ((2 * steps + 1)^2, 3), for up to 31 steps: not to be written to."""
    side = np.arange(2 * steps + 1)
    codes = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1)
    return _decoded(codes.reshape(-1, 2), steps)


def _decoded(codes: NDArray[np.integer], steps: int) -> NDArray[np.float64]:
    flat = codes.astype(np.float64) / steps - 1.0
    height = 1.0 - np.abs(flat).sum(axis=1)
    fold = np.maximum(-height, 0.0)[:, None]
    vectors = np.concatenate([flat - np.where(flat >= 0.0, fold, -fold), height[:, None]], axis=1)
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12))


@lru_cache(maxsize=4)
def steepest_axes(steps: int) -> NDArray[np.int32]:
    """The axis (2 * steps + 1, the same) that the normal of each code is nearest to; of two alike the first."""
    side = np.arange(2 * steps + 1)
    codes = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    parts = np.rint(np.abs(decode(codes, steps)) * 1024)  # whole: alike on every machine
    return np.asarray(parts.argmax(axis=1).reshape(len(side), len(side)), dtype=np.int32)
