"""From neural points to their surface by torch (paper III-C)."""

from __future__ import annotations

from itertools import product
from weakref import WeakKeyDictionary

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from lab.gpu.arrays import moved_there
from lab.gpu.compiled import CompiledSurfaces
from lab.gpu.kernels import Array, Cases, Cells, FieldRules, Mesh, Planes
from lab.gpu.neighbours import SortedPoints, blended_distances, blended_normals
from lab.gpu.order import VoxelKeys, first_seen, voxels_of
from revisit.core.kernels.surface_cells import NEAR_PLANE

_CUBE = np.array([(corner & 1, corner >> 1 & 1, corner >> 2 & 1) for corner in range(8)])


class TorchSurfaces:
    """`SurfaceKernels` on a device of torch."""

    def __init__(self, where: torch.device) -> None:
        """Everything is computed on `where`, but for planes too far apart for keys of voxels."""
        self._where, self._compiled = where, CompiledSurfaces()
        self._sorted: WeakKeyDictionary[Planes, SortedPoints | None] = WeakKeyDictionary()

    def cells(self, planes: Planes, observed: float) -> Cells:
        """See `SurfaceKernels`. A voxel is named by its lowest corner."""
        positions, resolution = self._there(planes.positions), planes.resolution
        steps = int(np.ceil(observed / resolution))
        homes = voxels_of(positions, resolution)
        keys = VoxelKeys.of(homes, margin=steps + 2) if len(homes) else None
        if keys is None:
            return self._compiled.cells(planes, observed)
        known = _observed_corners(positions, homes, keys, resolution, observed, steps)
        voxels = _voxels_near(positions, self._there(planes.normals), homes, keys, known, resolution)
        corners = keys(keys.voxels(voxels)[:, None] + self._there(_CUBE))
        rows = torch.searchsorted(known, corners.reshape(-1)).reshape(corners.shape)
        return Cells(keys.voxels(known).int().cpu().numpy(), rows.int().cpu().numpy())

    def distances(self, queries: Array, planes: Planes, rules: FieldRules) -> tuple[Array, Array]:
        """See `SurfaceKernels`."""
        points = self._points_of(planes)
        if points is None or len(queries) == 0:
            return self._compiled.distances(queries, planes, rules)
        there = self._there(queries)
        near = points.nearest(there, rules.neighbours, rules.rings)
        return blended_distances(there, points, near, rules.power).cpu().numpy(), near.distance.cpu().numpy()

    def blended_normals(self, queries: Array, planes: Planes, rules: FieldRules) -> Array:
        """See `SurfaceKernels`."""
        points = self._points_of(planes)
        if points is None or len(queries) == 0:
            return self._compiled.blended_normals(queries, planes, rules)
        near = points.nearest(self._there(queries), rules.neighbours, rules.rings)
        normals: NDArray[np.float32] = blended_normals(points, near, rules.power).cpu().numpy()
        return normals

    def polygonise(
        self, cell_corners: NDArray[np.int32], corners: Array, values: Array, cases: Cases, resolution: float
    ) -> Mesh:
        """See `SurfaceKernels`. Vertices are numbered in the order in which a loop over the cells would meet them."""
        rows, level = self._there(cell_corners).long(), self._there(values)
        at_corners = level[rows]
        solid = (at_corners < 0).long() << torch.arange(8, device=self._where)
        case = torch.where(at_corners.isnan().any(1), 0, solid.sum(1))
        crossing = (case > 0) & (case < 255)
        triangles, edges = self._there(cases.triangles).long()[case[crossing]], self._there(cases.edges)
        owners, which = torch.nonzero(triangles[:, :, 0] >= 0, as_tuple=True)
        low, axis = edges[triangles[owners, which]].unbind(-1)  # (f, 3)
        cell = rows[crossing][owners]
        begin, end = cell.gather(1, low), cell.gather(1, low | (1 << axis))
        numbers, first = first_seen((3 * begin + axis).reshape(-1))
        begin, end, axis = (part.reshape(-1)[first] for part in (begin, end, axis))
        share = level[begin] / (level[begin] - level[end])
        vertices = self._there(corners)[begin]
        moved = (vertices.gather(1, axis[:, None])[:, 0].double() + share.double() * resolution).float()
        vertices.scatter_(1, axis[:, None], moved[:, None])
        faces = numbers.reshape(-1, 3).int()
        return Mesh(vertices.cpu().numpy(), faces.cpu().numpy(), crossing.cpu().numpy())

    def any_within(self, queries: Array, points: Array, distance: float) -> NDArray[np.bool_]:
        """See `SurfaceKernels`."""
        there = self._there(points)
        known = SortedPoints.of(there, there, distance)
        if known is None or len(queries) == 0:
            return self._compiled.any_within(queries, points, distance)
        near: NDArray[np.bool_] = known.any_within(self._there(queries)).cpu().numpy()
        return near

    def _points_of(self, planes: Planes) -> SortedPoints | None:
        """The points of the planes, sorted once; None where they cannot be."""
        if planes not in self._sorted:
            positions, normals = self._there(planes.positions), self._there(planes.normals)
            self._sorted[planes] = SortedPoints.of(positions, normals, planes.resolution)
        return self._sorted[planes]

    def _there(self, array: NDArray[np.generic]) -> Tensor:
        return moved_there(array, self._where)


def _observed_corners(
    positions: Tensor, homes: Tensor, keys: VoxelKeys, resolution: float, observed: float, steps: int
) -> Tensor:
    """The keys (c,), ascending, of the voxel corners within `observed` metres of any of `positions` (n, 3)."""
    limit = np.float32(observed) * np.float32(observed)
    reach = range(1 - steps, steps + 1)
    within = moved_there(np.array(list(product(reach, reach))), homes.device)
    near, found = [], []
    for step in reach:  # the corners of all steps at once would take four times the room
        corners = homes[:, None] + torch.nn.functional.pad(within, (1, 0), value=step)
        x, y, z = (positions[:, None] - (corners.double() * resolution).float()).unbind(-1)
        near.append(x * x + y * y + z * z <= float(limit))
        found.append(keys(corners))
    distinct: Tensor = torch.unique(torch.cat(found)[torch.cat(near)])
    return distinct


def _voxels_near(
    positions: Tensor, normals: Tensor, homes: Tensor, keys: VoxelKeys, known: Tensor, resolution: float
) -> Tensor:
    """The keys (m,) of the voxels around `positions` (n, 3) that their planes come near, in the order of the points.

    As `kernels.surface_cells.find_cells`: all corners are among the `known` (c,).
    """
    around = moved_there(np.array(list(product((-1, 0, 1), repeat=3))), homes.device)
    voxels = homes[:, None] + around
    away = (voxels.double() + 0.5) * resolution - positions[:, None].double()
    parts = (away * normals[:, None].double()).unbind(-1)
    near = (parts[0] + parts[1] + parts[2]).abs() <= NEAR_PLANE * resolution
    candidates = keys(voxels)[near]
    distinct, numbers = torch.unique(candidates, return_inverse=True)
    corners = keys(keys.voxels(distinct)[:, None] + moved_there(_CUBE, homes.device))
    rows = torch.searchsorted(known, corners).clamp(max=len(known) - 1)
    complete = (known[rows] == corners).all(1)
    candidates = candidates[complete[numbers]]
    return candidates[first_seen(candidates)[1]]
