"""The nearest points around queries and their blend, by torch (paper III-B 2, Eq. 2-4)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from lab.gpu.arrays import moved_there
from lab.gpu.order import VoxelKeys, ranges, root, voxels_of
from revisit.core.kernels.neighbour_blend import NEAREST_M

_NOTHING = 0x7F800000 << 32  # infinitely far
_ROW = 0xFFFFFFFF
_AT_ONCE = 1 << 25
"""Candidates of some queries that are laid out side by side in one step."""


class Near(NamedTuple):
    """Of m queries the rows (m, K) of their nearest points, squared distances (m, K), and which there are (m, K)."""

    rows: Tensor
    squared: Tensor
    there: Tensor

    @property
    def distance(self) -> Tensor:
        """Metres (m,) to the nearest point; inf where there is none."""
        return root(self.squared[:, 0])


@dataclass(frozen=True)
class SortedPoints:
    """Points in the order of their voxels, on a device: positions and normals (n, 3), keys (n,), and their box."""

    positions: Tensor
    normals: Tensor
    known: Tensor
    keys: VoxelKeys
    resolution: float

    @classmethod
    def of(cls, positions: Tensor, normals: Tensor, resolution: float) -> SortedPoints | None:
        """The points sorted; None where there are none, or they are too far apart for keys of voxels."""
        voxels = voxels_of(positions, resolution)
        keys = VoxelKeys.of(voxels) if len(voxels) else None
        if keys is None:
            return None
        known, order = torch.sort(keys(voxels), stable=True)
        return cls(positions[order], normals[order], known, keys, resolution)

    def nearest(self, queries: Tensor, count: int, rings: int) -> Near:
        """The `count` nearest points within `rings` voxels of each query (m, 3), as `kernels.nearest_points`."""
        first, found = self._ranges(queries, rings)
        total = found.sum(1)
        best = torch.full((len(queries), count), _NOTHING, device=queries.device)
        width = max(int(total.amax()), count)
        step = max(1, _AT_ONCE // width)
        for start in range(0, len(queries), step):
            some = slice(start, start + step)
            best[some] = self._keep_nearest(queries[some], first[some], found[some], (count, width), rings)
        squared = (best >> 32).int().view(torch.float32)
        there = best < _NOTHING
        return Near(torch.where(there, best & _ROW, 0), squared, there)

    def any_within(self, queries: Tensor) -> Tensor:
        """Whether any point lies within the edge of a voxel of each query (m, 3), as `kernels.nearest_points`."""
        first, found = self._ranges(queries, 1)
        owners, rows = ranges(first.reshape(-1), found.reshape(-1))
        owners = owners // found.shape[1]
        x, y, z = (self.positions[rows].double() - queries[owners].double()).unbind(1)
        near = (x * x + y * y + z * z <= self.resolution * self.resolution).int()
        return torch.zeros(len(queries), dtype=torch.int32, device=queries.device).index_add_(0, owners, near) > 0

    def _ranges(self, queries: Tensor, rings: int) -> tuple[Tensor, Tensor]:
        """For each query and each column within `rings` where its points begin, and how many: (m, (2 rings + 1)^2)."""
        low, (width, depth, height) = self.keys.low, self.keys.shape
        homes = voxels_of(queries, self.resolution) - low
        steps = moved_there(np.array(list(product(range(-rings, rings + 1), repeat=2))), queries.device)
        columns = homes[:, None, :2] + steps
        x, y = columns.unbind(-1)
        bottom, top = (homes[:, 2] - rings).clamp(min=0), (homes[:, 2] + rings).clamp(max=height - 1)
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < depth) & (bottom <= top)[:, None]
        base = torch.where(inside, (x * depth + y) * height, 0)
        first = torch.searchsorted(self.known, base + bottom[:, None])
        last = torch.searchsorted(self.known, base + top[:, None], right=True)
        return first, torch.where(inside, last - first, 0)

    def _keep_nearest(
        self, queries: Tensor, first: Tensor, found: Tensor, shape: tuple[int, int], rings: int
    ) -> Tensor:
        """As numbers (m, count), ascending: the bits of a squared distance above the row. `shape` says how many are
        kept, and how many a query has at most.
        """
        count, width = shape
        owners, rows = ranges(first.reshape(-1), found.reshape(-1))
        owners = owners // found.shape[1]
        x, y, z = (self.positions[rows] - queries[owners]).unbind(1)
        squared = x * x + y * y + z * z
        numbers = (squared.view(torch.int32).long() << 32) | rows
        numbers = torch.where(squared < float(np.float32((rings * self.resolution) ** 2)), numbers, _NOTHING)
        total = found.sum(1)
        places = torch.arange(len(owners), device=queries.device) - (torch.cumsum(total, 0) - total)[owners]
        side_by_side = torch.full((len(queries), width), _NOTHING, device=queries.device)
        side_by_side[owners, places] = numbers
        best: Tensor = torch.topk(side_by_side, count, dim=1, largest=False).values
        return best


def blended_distances(queries: Tensor, points: SortedPoints, near: Near, power: float) -> Tensor:
    """Signed distances (m,) to the planes of the neighbours, as `kernels.plane_distance.plane_distance`."""
    weights = near.squared.clamp(min=float(np.float32(NEAREST_M * NEAREST_M))) ** (-0.5 * power) * near.there
    heights = (points.normals[near.rows] * (queries[:, None] - points.positions[near.rows])).sum(-1)
    total = weights.sum(1)
    return torch.where(total > 0.0, (weights * heights).sum(1) / total.clamp(min=1e-30), 0.0)


def blended_normals(points: SortedPoints, near: Near, power: float) -> Tensor:
    """Unit normals (m, 3), as `kernels.neighbour_blend.blend_normals`."""
    weights = root(near.squared).clamp(min=float(np.float32(NEAREST_M))) ** -power * near.there
    blended = (weights[..., None] * points.normals[near.rows]).sum(1)
    blended = blended / weights.sum(1).clamp(min=1e-30)[:, None]
    unit: Tensor = blended / blended.norm(dim=1, keepdim=True).clamp(min=1e-9)
    return unit
