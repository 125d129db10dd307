"""What still stands of the surfaces of submaps, on this machine: of drives over one place the latest decides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry.se3 import Matrix4

if TYPE_CHECKING:
    from revisit.core.implicit_map import NeuralMap
    from revisit.core.merge.fused import PlacedMap

HELD_MAPS = 512
"""Neural maps that are kept decoded: neighbouring squares are judged by the same."""


@dataclass(frozen=True)
class SurfaceOf:
    """A submap's stored neural map, its session by its number in the order of time, its time, and where it lies."""

    blob: bytes = field(repr=False)
    session: int
    stamp_ns: int
    T_map_submap: Matrix4


class Surfaces:
    """The surfaces of submaps in one frame."""

    def __init__(self, of: Sequence[SurfaceOf]) -> None:
        """Decoded when they are asked for."""
        self._of = of
        self._decoded = lru_cache(maxsize=HELD_MAPS)(self._decode)

    def neural_map(self, row: int) -> NeuralMap:
        """That of a submap."""
        return self._decoded(row)

    def points(self, row: int, stands: NDArray[np.bool_] | None = None) -> NDArray[np.float64]:
        """The neural points (n, 3) of a submap in its own frame, metres; those that stand, if that is said."""
        neural_map = self.neural_map(row)
        points = neural_map.frame.points_to_submap(neural_map.points.positions).astype(np.float64)
        return points if stands is None else points[stands]

    def placed(self, row: int) -> PlacedMap:
        """As the method takes it."""
        from revisit.core.merge.fused import PlacedMap

        one = self._of[row]
        return PlacedMap(self.neural_map(row), one.T_map_submap, one.session, one.stamp_ns)

    def standing(self, report: Callable[[str, int, int], None]) -> list[NDArray[np.bool_] | None]:
        """Which neural points (n,) of each submap still stand; None where all do. Judged square by square.

        `report` is told the stage, and how many squares of how many are judged.
        """
        from revisit.core.config import PipelineConfig
        from revisit.core.geometry.tile_grid import TileGrid
        from revisit.core.merge.tiles import standing_in_tile

        stands: list[NDArray[np.bool_] | None] = [None] * len(self._of)
        if len({one.session for one in self._of}) < 2:
            return stands
        first = self.neural_map(0)
        grid = TileGrid.of(first.config.resolution, first.frame.scale)
        reach_m = PipelineConfig().submap.surface_reach_m(first.frame.scale)
        positions = np.stack([one.T_map_submap[:3, 3] for one in self._of])
        squares = grid.reached(positions, reach_m)
        for number, (cell, rows) in enumerate(squares.items()):
            report("squares compared", number, len(squares))
            if len({self._of[row].session for row in rows.tolist()}) > 1:
                found = standing_in_tile([self.placed(row) for row in rows.tolist()], grid.centre(cell))
                for row, its in zip(rows.tolist(), found, strict=True):
                    before = stands[row]
                    stands[row] = its if before is None else before & its
        report("squares compared", len(squares), len(squares))
        return stands

    def gone(self, row: int, stands: NDArray[np.bool_] | None, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which points (n, 3) of a submap, in its own frame, lie on what of its surface no longer stands."""
        from scipy.spatial import cKDTree

        if stands is None or stands.all():
            return np.zeros(len(points), dtype=bool)
        neural_map = self.neural_map(row)
        reach_m = neural_map.config.resolution * neural_map.frame.scale
        gaps, nearest = cKDTree(self.points(row)).query(points, distance_upper_bound=reach_m)
        return np.append(~stands, False)[np.where(np.isfinite(gaps), nearest, len(stands))]

    def _decode(self, row: int) -> NeuralMap:
        from revisit.core.config import PipelineConfig
        from revisit.core.implicit_map import NeuralMap
        from revisit.core.model_bundle import load_packaged_models

        return NeuralMap.from_blob(self._of[row].blob, load_packaged_models().decoder, PipelineConfig().implicit_map)
