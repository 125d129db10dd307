"""Occupancy grids as the navigation stack of ROS 2 loads them: a PGM image and a YAML file beside it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField

OCCUPIED, FREE, UNKNOWN = 0, 254, 205
"""Grey values of the cells, as map savers write them."""

MAX_CELLS = 64_000_000

_GROUND_CELL_M = 2.0

_STANDING_M = 0.6
"""From this height on a point of a surface, one in a voxel of 0.4 m, is an obstacle: lower ones may be of a kerb."""

_MIDDLE = 4
"""Of the cells around a place."""


@dataclass(frozen=True)
class GridOptions:
    """resolution_m, the edge of a cell; an obstacle stands least_height_m to most_height_m above the ground around it.

    A cell with points, but without an obstacle, is free.
    """

    resolution_m: float = 0.1
    least_height_m: float = 0.3
    most_height_m: float = 2.0


@dataclass(frozen=True)
class OccupancyGrid:
    """cells (rows, columns) uint8, row 0 at the top, the largest y; origin (2,), the lower left corner in metres."""

    cells: NDArray[np.uint8]
    origin: tuple[float, float]
    resolution_m: float

    def to_pgm(self) -> bytes:
        """The image, binary PGM."""
        rows, columns = self.cells.shape
        return f"P5\n{columns} {rows}\n255\n".encode() + self.cells.tobytes()

    def to_yaml(self, image: str) -> str:
        """The description of the image file `image`, which lies beside it."""
        x, y = self.origin
        return (
            f"image: {image}\nmode: trinary\nresolution: {self.resolution_m:g}\norigin: [{x:.6f}, {y:.6f}, 0.0]\n"
            "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
        )


def grid_of(points: NDArray[np.floating], options: GridOptions = GridOptions()) -> OccupancyGrid:
    """The grid of points (n, 3) in metres, z up.

    The ground of a point is the lowest point within its square of 2 m. Raises BadField without points and for a grid of
    more than MAX_CELLS.
    """
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise BadField("an occupancy grid needs points (n, 3)", field="points")
    low = np.floor(points[:, :2].min(axis=0) / options.resolution_m).astype(np.int64)
    places = np.floor(points[:, :2] / options.resolution_m).astype(np.int64) - low
    columns, rows = (int(size) for size in places.max(axis=0) + 1)
    if rows * columns > MAX_CELLS:
        raise BadField(f"the grid would have {rows} x {columns} cells: take a coarser resolution", field="resolution")
    height = points[:, 2] - _ground_under(points)
    cells = np.full((rows, columns), UNKNOWN, dtype=np.uint8)
    cells[places[:, 1], places[:, 0]] = FREE
    standing = (height >= options.least_height_m) & (height <= options.most_height_m)
    cells[places[standing, 1], places[standing, 0]] = OCCUPIED
    corner = low * options.resolution_m
    return OccupancyGrid(np.ascontiguousarray(cells[::-1]), (float(corner[0]), float(corner[1])), options.resolution_m)


def without_gone(
    grid: OccupancyGrid, newest: OccupancyGrid, ever: NDArray[np.floating], now: NDArray[np.floating], voxel_m: float
) -> OccupancyGrid:
    """A grid of several drives without the obstacles that no longer stand; those of the `newest` drive all do.

    `ever` (n, 3) and `now` (m, 3) are points of the surface of the same map, one in a voxel: all that was ever there,
    and that which the latest drive left. An obstacle is gone where the first has one within a voxel and the second
    none; its cell is then free, or unknown where the second has nothing. Raises as `grid_of`.
    """
    rows, columns = np.nonzero(grid.cells == OCCUPIED)
    if not len(rows) or not len(ever) or not len(now):
        return grid
    centres = np.column_stack([columns + 0.5, len(grid.cells) - rows - 0.5]) * grid.resolution_m + grid.origin
    options = GridOptions(resolution_m=voxel_m, least_height_m=_STANDING_M)
    stood, left = (_around(grid_of(points, options), centres) for points in (ever, now))
    gone = (stood == OCCUPIED).any(axis=1) & (left != OCCUPIED).all(axis=1)
    gone &= _around(newest, centres)[:, _MIDDLE] != OCCUPIED
    cells = grid.cells.copy()
    seen = (left[gone] == FREE).any(axis=1)
    cells[rows[gone], columns[gone]] = np.where(seen, FREE, UNKNOWN)
    return replace(grid, cells=cells)


def _around(grid: OccupancyGrid, places: NDArray[np.float64]) -> NDArray[np.uint8]:
    """The cells (n, 9) at and around `places` (n, 2), metres; outside of the grid nothing is known."""
    cells = np.pad(grid.cells[::-1], 1, constant_values=UNKNOWN)
    at = np.floor((places - grid.origin) / grid.resolution_m).astype(np.int64) + 1
    steps = np.array([(column, row) for column in (-1, 0, 1) for row in (-1, 0, 1)])
    columns, rows = np.moveaxis(at[:, None] + steps, -1, 0)
    last = np.array(cells.shape) - 1
    outside = (columns < 0) | (rows < 0) | (columns > last[1]) | (rows > last[0])
    found = cells[np.clip(rows, 0, last[0]), np.clip(columns, 0, last[1])]
    return np.where(outside, UNKNOWN, found).astype(np.uint8)


def _ground_under(points: NDArray[np.floating]) -> NDArray[np.float64]:
    """The height (n,) of the lowest point within the square of each point."""
    squares = np.floor(points[:, :2] / _GROUND_CELL_M).astype(np.int64)
    squares -= squares.min(axis=0)
    _, inverse = np.unique(squares[:, 0] * (squares[:, 1].max() + 1) + squares[:, 1], return_inverse=True)
    lowest = np.full(int(inverse.max()) + 1, np.inf)
    np.minimum.at(lowest, inverse, points[:, 2])
    return np.asarray(lowest[inverse])
