"""Unit vectors as two small integers: the octahedron unfolded into a square."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def encode(vectors: NDArray[np.floating], steps: int) -> NDArray[np.uint8]:
    """Codes (n, 2) in 0..2 * steps of unit vectors (n, 3); `steps` up to 127. The zero vector becomes +z."""
    folded = vectors / np.maximum(np.abs(vectors).sum(axis=1, keepdims=True), 1e-12)
    flat = folded[:, :2]
    lower = (1.0 - np.abs(flat[:, ::-1])) * np.where(flat >= 0.0, 1.0, -1.0)
    square = np.where(folded[:, 2:] < 0.0, lower, flat)
    return np.asarray(np.rint((square + 1.0) * steps), dtype=np.uint8)


def decode(codes: NDArray[np.integer], steps: int) -> NDArray[np.float64]:
    """The unit vectors (n, 3) of codes (n, 2): within about 2 / steps radians of what was encoded."""
    flat = codes.astype(np.float64) / steps - 1.0
    height = 1.0 - np.abs(flat).sum(axis=1)
    fold = np.maximum(-height, 0.0)[:, None]
    vectors = np.concatenate([flat - np.where(flat >= 0.0, fold, -fold), height[:, None]], axis=1)
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12))
