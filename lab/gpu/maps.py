"""From returns to neural points by torch (paper III-B)."""

from __future__ import annotations

from collections.abc import Callable
from weakref import ref

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lab.gpu.arrays import moved_there
from lab.gpu.compiled import CompiledMaps
from lab.gpu.kernels import Array, Array64, Planes, Returns
from lab.gpu.normals import oriented_normals
from lab.gpu.order import Groups, VoxelKeys, first_seen, ranges, root, voxels_of
from lab.gpu.replay import replayed
from lab.gpu.visibility import nearest_around, pixels_of, range_images, seen_through
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
        self._points: tuple[Callable[[], object], Tensor] | None = None

    def gather(self, returns: Returns, resolution: float, limit: int) -> Array64:
        """See `MapKernels`."""
        points = self._returns(returns.points)
        voxels = torch.floor(points.double() * (1.0 / resolution)).long()
        keys = VoxelKeys.of(voxels) if len(points) else None
        if keys is None:
            return self._compiled.gather(returns, resolution, limit)
        rows, first = first_seen(keys(voxels))
        scans = torch.repeat_interleave(self._there(np.diff(returns.bounds)), output_size=len(points))
        if len(first) > limit:
            kept = rows < limit
            points, voxels, scans, rows, first = points[kept], voxels[kept], scans[kept], rows[kept], first[:limit]
            first = torch.searchsorted(torch.nonzero(kept)[:, 0], first)
        towards = _units(self._there(returns.origins)[scans] - points)
        groups = Groups.of(rows, len(first))
        moments, views = _moments(points, voxels, groups, first, resolution), groups.sums(towards, 1.0)
        return torch.cat([moments, views, _scans_of(scans, groups)], dim=1).cpu().numpy()

    def orient(self, positions: Array, records: Array64, everywhere: Planes, gathered: Array64) -> Array:
        """See `MapKernels`."""
        if len(positions) == 0:
            return self._compiled.orient(positions, records, everywhere, gathered)
        means, queries = self._there(everywhere.positions), self._there(positions)
        voxels = voxels_of(means, everywhere.resolution)
        keys = VoxelKeys.of(voxels, margin=1)
        if keys is None:
            return self._compiled.orient(positions, records, everywhere, gathered)
        (spreads,) = _own_spreads(means.double(), self._there(gathered[:, MOMENTS]))
        order, pairs = _pairs_around(queries, voxels, keys, everywhere.resolution)
        pooled = _pooled(queries, means[order], spreads[order], *pairs, everywhere.resolution)
        return oriented_normals(pooled, self._there(records[:, VIEW])).cpu().numpy()

    def see_through(self, positions: Array, returns: Returns) -> NDArray[np.int32]:
        """See `MapKernels`."""
        points, origins = self._returns(returns.points), self._there(returns.origins)
        scans = torch.repeat_interleave(self._there(np.diff(returns.bounds)), output_size=len(points))
        pixels, measured = pixels_of(points - origins[scans])
        nearest = nearest_around(range_images(pixels, measured, scans, len(origins)))
        queries = self._there(positions)
        counts = torch.zeros(len(queries), dtype=torch.int32, device=self._where)
        step = max(1, _SEEN_AT_ONCE // max(len(queries), 1))
        for start in range(0, len(origins), step):
            some = slice(start, start + step)
            counts += seen_through(queries[None] - origins[some, None], nearest[some])
        return counts.cpu().numpy()

    def _returns(self, points: Array) -> Tensor:
        """The points on the device, moved there once: those of a submap are asked for twice."""
        if self._points is None or self._points[0]() is not points:
            self._points = ref(points), self._there(points)
        return self._points[1]

    def _there(self, array: NDArray[np.generic]) -> Tensor:
        return moved_there(array, self._where)


def _units(rays: Tensor) -> Tensor:
    """Unit vectors (n, 3) of `rays` (n, 3), of 32 bits."""
    x, y, z = rays.unbind(1)
    return rays * (1.0 / (root(x * x + y * y + z * z) + _TINY_M))[:, None]


def _moments(points: Tensor, voxels: Tensor, groups: Groups, first: Tensor, resolution: float) -> Tensor:
    """Count, sum p and upper sum p p^T (m, 10) of the returns (n, 3) of each voxel."""
    linear, square, apart = _terms(points, voxels, resolution=resolution)
    sums = [groups.sums(part, part.abs().amax() + _TINY_M) for part in (linear, square)]
    count = groups.sizes.double()[:, None]
    return torch.cat([count, torch.cat(sums, dim=1) + count * apart[first]], dim=1)


@replayed
def _terms(points: Tensor, voxels: Tensor, *, resolution: float) -> tuple[Tensor, Tensor, Tensor]:
    """How p (n, 3) and upper p p^T (n, 6) of returns differ from those (n, 9) of the middles of their voxels.

    The difference, which is small, is what is added up. Products are of 32 bits, as in the compiled kernel: normals of
    lone returns hang on their rounding (docs/decisions/0111).
    """
    middles = (voxels + 0.5) * resolution
    products = torch.stack([points[:, i] * points[:, j] for i, j in _UPPER], dim=1)
    apart = torch.cat([middles, torch.stack([middles[:, i] * middles[:, j] for i, j in _UPPER], dim=1)], dim=1)
    return points.double() - apart[:, :3], products.double() - apart[:, 3:], apart


def _scans_of(scans: Tensor, groups: Groups) -> Tensor:
    """The first, the last and the number of the scans (m, 3) that saw each group; scans ascend."""
    rows, count = groups.rows, len(groups.sizes)
    first = torch.full((count,), len(scans), device=scans.device).scatter_reduce(0, rows, scans, "amin")
    last = torch.zeros(count, dtype=scans.dtype, device=scans.device).scatter_reduce(0, rows, scans, "amax")
    pairs = torch.unique(rows * (last.max() + 1) + scans) // (last.max() + 1)
    return torch.stack([first, last, Groups.of(pairs, count).sizes], dim=1).double()


@replayed
def _own_spreads(means: Tensor, moments: Tensor) -> tuple[Tensor]:
    """As `kernels.elastic_points._own_spreads`: weight and upper mean d d^T (n, 7) float32."""
    count = moments[:, 0]
    columns = [count.clamp(max=POOLED_RETURNS)]
    for column, (i, j) in enumerate(_UPPER):
        cross = means[:, i] * moments[:, 1 + j], means[:, j] * moments[:, 1 + i]
        columns.append((moments[:, 4 + column] - cross[0] - cross[1]) / count + means[:, i] * means[:, j])
    return (torch.stack(columns, dim=1).float(),)


def _pairs_around(
    queries: Tensor, voxels: Tensor, keys: VoxelKeys, resolution: float
) -> tuple[Tensor, tuple[Tensor, Tensor]]:
    """The order (n,) of `voxels` (n, 3) by their keys, and all pairs of a query (m, 3) and a row in that order whose
    voxel is among the 27 around it: query (p,) and row (p,).
    """
    known, order = torch.sort(keys(voxels), stable=True)
    homes = voxels_of(queries, resolution)[:, None]
    steps = moved_there(np.array([[x, y, -1] for x, y in _AROUND]), queries.device)
    lowest = keys(homes + steps)  # of three voxels above each other
    first = torch.searchsorted(known, lowest.reshape(-1))
    owners, rows = ranges(first, torch.searchsorted(known, lowest.reshape(-1) + 3) - first)
    return order, (owners // len(_AROUND), rows)


def _pooled(
    queries: Tensor, points: Tensor, spreads: Tensor, owners: Tensor, rows: Tensor, resolution: float
) -> Tensor:
    """As `kernels.elastic_points._pool`: covariances (m, 3, 3) of the returns around each of `queries` (m, 3)."""
    (shares,) = _shares(points[rows] - queries[owners], spreads[rows], resolution=resolution)
    greatest = POOLED_RETURNS * max(1.0, 12.0 * resolution, 16.0 * resolution**2)
    (covariances,) = _covariances(Groups.of(owners, len(queries)).sums(shares, greatest))
    return covariances


@replayed
def _covariances(sums: Tensor) -> tuple[Tensor]:
    """Of count, sum d and upper sum d d^T (m, 10): (m, 3, 3)."""
    mean, second = sums[:, 1:4] / sums[:, :1], sums[:, 4:] / sums[:, :1]
    upper = {pair: second[:, column] - mean[:, pair[0]] * mean[:, pair[1]] for column, pair in enumerate(_UPPER)}
    entries = [upper[min(i, j), max(i, j)] for i in range(3) for j in range(3)]
    return (torch.stack(entries, dim=1).reshape(-1, 3, 3),)


@replayed
def _shares(away: Tensor, spreads: Tensor, *, resolution: float) -> tuple[Tensor]:
    """The addends of pairs to count, sum d and upper sum d d^T (p, 10) of a query `away` (p, 3) from each point."""
    gap = away[:, 0] * away[:, 0] + away[:, 1] * away[:, 1] + away[:, 2] * away[:, 2]
    scale, farthest = np.float32(-0.5 / (0.7 * resolution) ** 2), np.float32(4.0 * resolution**2)
    weight = torch.exp((gap * float(scale)).double()).float() * spreads[:, 0] * (gap <= float(farthest))
    shares = [weight, *(weight * away[:, a] for a in range(3))]
    for column, (i, j) in enumerate(_UPPER):
        shares.append(weight * (spreads[:, 1 + column] + away[:, i] * away[:, j]))
    return (torch.stack(shares, dim=1),)
