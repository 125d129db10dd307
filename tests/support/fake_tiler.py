"""A tiler for submaps whose neural maps are made up: a flat floor at the height of the first submap."""

from __future__ import annotations

import numpy as np

from revisit.core.codec.mesh import Mesh
from revisit.core.codec.tile import FusedTile

HALF_M = 25.6
UP = np.tile(np.float32([0.0, 0.0, 1.0]), (4, 1))


class FakeTiler:
    """`TileMaker`: two triangles over the whole tile, whose distance is the height above them."""

    def __init__(self) -> None:
        self.made = 0

    def fuse(self, placed, centre_m, read) -> FusedTile | None:
        """Every neural map is read; an even column has a floor, an odd one holds nothing."""
        self.made += 1
        for one in placed:
            assert read(one.sha256)
        height = float(placed[0].T_map_submap[2, 3])
        if int(np.floor(centre_m[0] / (2 * HALF_M))) % 2:
            return None
        corners = np.float32([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * HALF_M + np.float32([0, 0, height])
        floor = Mesh(corners, UP, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
        points = Mesh(corners * np.float32([0.5, 0.5, 1.0]), UP, np.zeros((0, 3), np.int32))
        return FusedTile(str(height).encode(), floor, points)

    def distances_m(self, neural_map, points):
        """Known up to a metre above the floor."""
        above = (points[:, 2] - float(neural_map)).astype(np.float32)
        return above, np.where(np.abs(above) <= 1.0, np.abs(above), np.inf).astype(np.float32)
