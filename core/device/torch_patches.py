"""Nearest points of many surfaces at once, by torch.

Every query looks through the columns within reach: rows of the sorted patches, one range for each row of columns. All
ranges of all queries are laid end to end, so that work grows with the points that are looked at and not with the
fullest column.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from revisit.core.kernels.patches import Patches

NOWHERE = -1


@dataclass(frozen=True)
class Tables:
    """The patches of several jobs on a device; a surface that several jobs share is there once.

    records (r, 8) float32 of all surfaces; grid (g,) int64, where each of their columns begins among the records; and
    of each job (j, 5) int64: where its grid begins, its lowest column (x, y), width and depth in columns.
    """

    records: Tensor
    grid: Tensor
    jobs: Tensor

    @classmethod
    def of(cls, patches: Sequence[Patches], where: torch.device) -> Tables:
        """The tables of the patches of each job, which have a grid."""
        distinct = {id(one.records): one for one in patches}
        places, records, grids = {}, 0, 0
        for key, one in distinct.items():
            places[key] = (records, grids)
            records, grids = records + len(one.records), grids + len(one.grid)
        grid = np.concatenate([one.grid.astype(np.int64) + places[key][0] for key, one in distinct.items()])
        jobs = np.array([(places[id(one.records)][1], *one.low, *one.shape) for one in patches], dtype=np.int64)
        return cls(
            torch.as_tensor(np.concatenate([one.records for one in distinct.values()]), device=where),
            torch.as_tensor(grid, device=where),
            torch.as_tensor(jobs, device=where),
        )

    def of_jobs(self, rows: Tensor) -> Tables:
        """The tables of some of the jobs."""
        return Tables(self.records, self.grid, self.jobs[rows])

    def nearest(self, points: Tensor, there: Tensor, edge: float, reach: float) -> Tensor:
        """The record (j, n) nearest to each of `points` (j, n, 3) and nearer than `reach`; NOWHERE for none.

        `there` (j, n) says which points there are; columns have `edge` metres. Of records equally far it is the first.
        """
        first, count, rings = self._ranges(points, there, edge, int(np.ceil(reach / edge)))
        queries, ends = points.float().reshape(-1, 3), torch.cumsum(count, 0)
        ranges = torch.repeat_interleave(torch.arange(len(count), device=count.device), count)
        rows = first[ranges] + torch.arange(len(ranges), device=count.device) - (ends - count)[ranges]
        owners = ranges // rings
        gaps = self.records[rows, :3] - queries[owners]
        squared = gaps[:, 0] * gaps[:, 0] + gaps[:, 1] * gaps[:, 1] + gaps[:, 2] * gaps[:, 2]
        farthest = torch.full((len(queries),), float(np.float32(reach * reach)), device=count.device)
        least = farthest.scatter_reduce(0, owners, squared, "amin")
        hit = (squared == least[owners]) & (squared < farthest[owners])
        found = torch.full((len(queries),), len(self.records), dtype=torch.int64, device=count.device)
        found = found.scatter_reduce(0, owners[hit], rows[hit], "amin")
        return torch.where(found < len(self.records), found, NOWHERE).reshape(there.shape)

    def _ranges(self, points: Tensor, there: Tensor, edge: float, reach: int) -> tuple[Tensor, Tensor, int]:
        """For each point and each of the rows of columns around it the first record, and how many follow: flat."""
        start, x_low, y_low, width, depth = (self.jobs[:, part, None, None] for part in range(5))
        home = torch.floor(points[..., :2] / edge).clamp(-(2.0**40), 2.0**40).long()
        x = home[..., 0, None] - x_low + torch.arange(-reach, reach + 1, device=points.device)
        y = home[..., 1, None] - y_low
        lowest, highest = (y - reach).clamp(min=0), torch.minimum(y + reach, depth - 1)
        inside = there[..., None] & (x >= 0) & (x < width) & (lowest <= highest)
        begin = torch.where(inside, start + x * depth + lowest, 0)
        end = torch.where(inside, start + x * depth + highest + 1, 0)
        first = self.grid[begin]
        return first.reshape(-1), (self.grid[end] - first).reshape(-1), 2 * reach + 1
