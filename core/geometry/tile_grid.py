"""A grid of square tiles over a frame of a map, seen from above: the content of a square, and its surroundings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

TILE_VOXELS = 128
"""Edge of a tile in voxels, so that the voxels of neighbours meet: 51.2 m in a scene of the size of a street."""

Cell = tuple[int, int]
"""Column and row of a tile: the square from (column, row) to (column + 1, row + 1) edges."""


@dataclass(frozen=True)
class TileGrid:
    """Tiles of one size; edge_m in metres."""

    edge_m: float

    @classmethod
    def of(cls, resolution: float, scale: float) -> TileGrid:
        """The grid of neural maps of this `resolution` (metres, divided by the scale) in a scene of this scale."""
        return cls(TILE_VOXELS * resolution * scale)

    def centre(self, cell: Cell) -> NDArray[np.float64]:
        """The middle (3,) of a tile, metres, at height 0."""
        return np.array([(cell[0] + 0.5) * self.edge_m, (cell[1] + 0.5) * self.edge_m, 0.0])

    def bounds(self, cell: Cell) -> tuple[tuple[float, float], tuple[float, float]]:
        """The lower and the upper corner of a tile, (x, y) metres."""
        column, row = cell
        return (column * self.edge_m, row * self.edge_m), ((column + 1) * self.edge_m, (row + 1) * self.edge_m)

    def cells(self, points: NDArray[np.floating]) -> list[Cell]:
        """The tile of each of the `points` (n, 2 or 3), metres."""
        return [(int(column), int(row)) for column, row in np.floor(points[:, :2] / self.edge_m)]

    def reached(self, positions: NDArray[np.floating], reach_m: float) -> dict[Cell, NDArray[np.int64]]:
        """Of each tile that lies within `reach_m` of one of the `positions` (n, 3), the rows of those, in order."""
        own, around = np.floor(positions[:, :2] / self.edge_m).astype(np.int64), self._around(reach_m)
        cells = own[:, None] + around[None]
        aside = np.maximum(0.0, np.abs(positions[:, None, :2] - (cells + 0.5) * self.edge_m) - 0.5 * self.edge_m)
        rows, which = np.nonzero(np.hypot(aside[..., 0], aside[..., 1]) <= reach_m)
        keys = (cells[rows, which, 0] << 32) + cells[rows, which, 1] + 2**31
        order = np.argsort(keys, kind="stable")
        found, starts = np.unique(keys[order], return_index=True)
        parts = np.split(rows[order], starts[1:])
        return {(key >> 32, (key & 0xFFFFFFFF) - 2**31): part for key, part in zip(found.tolist(), parts, strict=False)}

    def distances_m(self, cell: Cell, positions: NDArray[np.floating]) -> NDArray[np.float64]:
        """How far `positions` (n, 3) lie from the square of a tile (n,), seen from above; 0 within."""
        aside = np.maximum(0.0, np.abs(positions[:, :2] - self.centre(cell)[:2]) - 0.5 * self.edge_m)
        return np.hypot(aside[:, 0], aside[:, 1])

    def _around(self, reach_m: float) -> NDArray[np.int64]:
        """Steps (k, 2) from a tile to all that may lie within `reach_m` of a position in it."""
        rings = int(np.ceil(reach_m / self.edge_m))
        steps = np.arange(-rings, rings + 1)
        return np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
