"""A tiler for submaps whose neural maps are made up: a flat floor at the height of the first submap."""

from __future__ import annotations

import numpy as np

from revisit.core.codec.mesh import Mesh
from revisit.core.codec.tile import FusedTile
from revisit.core.merge.evidence import ChangedThing, ChangeKind, DatedChange

HALF_M = 25.6
UP = np.tile(np.float32([0.0, 0.0, 1.0]), (4, 1))


class FakeTiler:
    """`TileMaker`: two triangles over the whole tile, whose distance is the height above them."""

    def __init__(self) -> None:
        self.made, self.compared = 0, 0
        self.drives: list[set[int]] = []

    def fuse(self, placed, centre_m, read) -> FusedTile | None:
        """Every neural map is read; an even column has a floor, an odd one holds nothing."""
        self.made += 1
        self.drives.append({one.session for one in placed})
        for one in placed:
            assert read(one.sha256)
        if not placed or int(np.floor(centre_m[0] / (2 * HALF_M))) % 2:
            return None
        height = float(placed[0].T_map_submap[2, 3])
        corners = np.float32([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * HALF_M + np.float32([0, 0, height])
        floor = Mesh(corners, UP, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
        points = Mesh(corners * np.float32([0.5, 0.5, 1.0]), UP, np.zeros((0, 3), np.int32))
        return FusedTile(str(height).encode(), floor, points)

    def changes(self, placed, centre_m, read):
        """One thing in the middle of the square, which the last of several drives found gone."""
        self.compared += 1
        for one in placed:
            assert read(one.sha256)
        if len({one.session for one in placed}) < 2:
            return []
        last, before = (max(one.stamp_ns for one in some) for some in (placed, placed[:1]))
        thing = ChangedThing(ChangeKind.VANISHED, tuple(centre_m.tolist()), (4.0, 2.0, 1.5), 40)
        return [DatedChange(thing, placed[-1].session, last, before)]

    def distances_m(self, neural_map, points):
        """Known up to a metre above the floor."""
        above = (points[:, 2] - float(neural_map)).astype(np.float32)
        return above, np.where(np.abs(above) <= 1.0, np.abs(above), np.inf).astype(np.float32)
