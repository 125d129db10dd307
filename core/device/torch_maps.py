"""From returns to neural points by torch (paper III-B)."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from revisit.core.device.compiled_description import CompiledMaps
from revisit.core.device.description import Array, Array64, Planes, Returns
from revisit.core.device.torch_arrays import moved_there
from revisit.core.device.torch_normals import oriented_normals
from revisit.core.device.torch_order import VoxelKeys, exact_sums, first_seen, ranges, root, voxels_of
from revisit.core.device.torch_visibility import nearest_around, pixels_of, range_images, seen_through
from revisit.core.kernels.elastic_points import MOMENTS, POOLED_RETURNS, VIEW

_UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_TINY_M = 1e-9
_AROUND = tuple((x, y) for x in (-1, 0, 1) for y in (-1, 0, 1))
_SEEN_AT_ONCE = 1 << 24
"""Positions times scans that are looked at in one step, so that memory does not grow with both."""


class TorchMaps:
    """`MapKernels` on a device of torch."""

    def __init__(self, where: torch.device) -> None:
        """Everything is computed on `where`, but for returns too far apart for keys of voxels."""
        self._where, self._compiled = where, CompiledMaps()

    def gather(self, returns: Returns, resolution: float, limit: int) -> Array64:
        """See `MapKernels`."""
        points = self._there(returns.points)
        voxels = torch.floor(points.double() * (1.0 / resolution)).long()
        keys = VoxelKeys.of(voxels) if len(points) else None
        if keys is None:
            return self._compiled.gather(returns, resolution, limit)
        rows, first = first_seen(keys(voxels))
        scans = torch.repeat_interleave(self._there(np.diff(returns.bounds)))
        if len(first) > limit:
            kept = rows < limit
            points, voxels, scans, rows, first = points[kept], voxels[kept], scans[kept], rows[kept], first[:limit]
            first = torch.searchsorted(torch.nonzero(kept)[:, 0], first)
        towards = _units(self._there(returns.origins)[scans] - points)
        moments = _moments(points, voxels, rows, first, resolution)
        views = exact_sums(towards, rows, len(first), 1.0)
        times = _scans_of(scans, rows, len(first))
        return torch.cat([moments, views, times], dim=1).cpu().numpy()

    def orient(self, positions: Array, records: Array64, everywhere: Planes, gathered: Array64) -> Array:
        """See `MapKernels`."""
        if len(positions) == 0:
            return self._compiled.orient(positions, records, everywhere, gathered)
        means, queries = self._there(everywhere.positions), self._there(positions)
        voxels = voxels_of(means, everywhere.resolution)
        keys = VoxelKeys.of(voxels, margin=1)
        if keys is None:
            return self._compiled.orient(positions, records, everywhere, gathered)
        spreads = _own_spreads(means.double(), self._there(gathered[:, MOMENTS]))
        order, pairs = _pairs_around(queries, voxels, keys, everywhere.resolution)
        pooled = _pooled(queries, means[order], spreads[order], *pairs, everywhere.resolution)
        return oriented_normals(pooled, self._there(records[:, VIEW])).cpu().numpy()

    def see_through(self, positions: Array, returns: Returns) -> NDArray[np.int32]:
        """See `MapKernels`."""
        points, origins = self._there(returns.points), self._there(returns.origins)
        scans = torch.repeat_interleave(self._there(np.diff(returns.bounds)))
        nearest = nearest_around(range_images(*pixels_of(points - origins[scans]), scans, len(origins)))
        queries = self._there(positions)
        counts = torch.zeros(len(queries), dtype=torch.int32, device=self._where)
        step = max(1, _SEEN_AT_ONCE // max(len(queries), 1))
        for start in range(0, len(origins), step):
            some = slice(start, start + step)
            counts += seen_through(queries[None] - origins[some, None], nearest[some])
        return counts.cpu().numpy()

    def _there(self, array: NDArray[np.generic]) -> Tensor:
        return moved_there(array, self._where)


def _units(rays: Tensor) -> Tensor:
    """Unit vectors (n, 3) of `rays` (n, 3), of 32 bits."""
    x, y, z = rays.unbind(1)
    return rays * (1.0 / (root(x * x + y * y + z * z) + _TINY_M))[:, None]


def _moments(points: Tensor, voxels: Tensor, rows: Tensor, first: Tensor, resolution: float) -> Tensor:
    """Count, sum p and upper sum p p^T (m, 10) of the returns (n, 3) of each voxel.

    What is added up is the difference to the middle of the voxel, which is small. Products are of 32 bits, as in the
    compiled kernel: normals of lone returns hang on their rounding (docs/decisions/0178).
    """
    middles = (voxels + 0.5) * resolution
    terms = torch.cat([points, torch.stack([points[:, i] * points[:, j] for i, j in _UPPER], dim=1)], dim=1)
    apart = torch.cat([middles, torch.stack([middles[:, i] * middles[:, j] for i, j in _UPPER], dim=1)], dim=1)
    away = terms.double() - apart
    parts = away[:, :3], away[:, 3:]
    sums = [exact_sums(part, rows, len(first), float(part.abs().amax()) + _TINY_M) for part in parts]
    count = torch.bincount(rows, minlength=len(first)).double()[:, None]
    return torch.cat([count, torch.cat(sums, dim=1) + count * apart[first]], dim=1)


def _scans_of(scans: Tensor, rows: Tensor, count: int) -> Tensor:
    """The first, the last and the number of the scans (m, 3) that saw each of `count` voxels; scans ascend."""
    first = torch.full((count,), len(scans), device=scans.device).scatter_reduce(0, rows, scans, "amin")
    last = torch.zeros(count, dtype=scans.dtype, device=scans.device).scatter_reduce(0, rows, scans, "amax")
    pairs = torch.unique(rows * (last.max() + 1) + scans) // (last.max() + 1)
    return torch.stack([first, last, torch.bincount(pairs, minlength=count)], dim=1).double()


def _own_spreads(means: Tensor, moments: Tensor) -> Tensor:
    """As `kernels.elastic_points._own_spreads`: weight and upper mean d d^T (n, 7) float32."""
    count = moments[:, 0]
    columns = [count.clamp(max=POOLED_RETURNS)]
    for column, (i, j) in enumerate(_UPPER):
        cross = means[:, i] * moments[:, 1 + j], means[:, j] * moments[:, 1 + i]
        columns.append((moments[:, 4 + column] - cross[0] - cross[1]) / count + means[:, i] * means[:, j])
    return torch.stack(columns, dim=1).float()


def _pairs_around(
    queries: Tensor, voxels: Tensor, keys: VoxelKeys, resolution: float
) -> tuple[Tensor, tuple[Tensor, Tensor]]:
    """The order (n,) of `voxels` (n, 3) by their keys, and all pairs of a query (m, 3) and a row in that order whose
    voxel is among the 27 around it: query (p,) and row (p,).
    """
    known, order = torch.sort(keys(voxels), stable=True)
    homes = voxels_of(queries, resolution)[:, None]
    steps = torch.tensor([[x, y, -1] for x, y in _AROUND], device=queries.device)
    lowest = keys(homes + steps)  # of three voxels above each other
    first = torch.searchsorted(known, lowest.reshape(-1))
    owners, rows = ranges(first, torch.searchsorted(known, lowest.reshape(-1) + 3) - first)
    return order, (owners // len(_AROUND), rows)


def _pooled(
    queries: Tensor, points: Tensor, spreads: Tensor, owners: Tensor, rows: Tensor, resolution: float
) -> Tensor:
    """As `kernels.elastic_points._pool`: covariances (m, 3, 3) of the returns around each of `queries` (m, 3)."""
    away = points[rows] - queries[owners]
    gap = away[:, 0] * away[:, 0] + away[:, 1] * away[:, 1] + away[:, 2] * away[:, 2]
    scale, farthest = np.float32(-0.5 / (0.7 * resolution) ** 2), np.float32(4.0 * resolution**2)
    weight = torch.exp((gap * float(scale)).double()).float() * spreads[rows, 0] * (gap <= float(farthest))
    shares = [weight, *(weight * away[:, a] for a in range(3))]
    for column, (i, j) in enumerate(_UPPER):
        shares.append(weight * (spreads[rows, 1 + column] + away[:, i] * away[:, j]))
    greatest = POOLED_RETURNS * max(1.0, 12.0 * resolution, 16.0 * resolution**2)
    sums = exact_sums(torch.stack(shares, dim=1), owners, len(queries), greatest)
    mean, second = sums[:, 1:4] / sums[:, :1], sums[:, 4:] / sums[:, :1]
    pooled = torch.empty((len(queries), 3, 3), dtype=torch.float64, device=queries.device)
    for column, (i, j) in enumerate(_UPPER):
        pooled[:, i, j] = pooled[:, j, i] = second[:, column] - mean[:, i] * mean[:, j]
    return pooled
