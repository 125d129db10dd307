"""Planes of a cloud and the corner points along their edges, as STD (Yuan et al., ICRA 2023) finds them.

The cloud is divided into voxels; those with flat points are pieces of planes, and neighbours with like normals are one
plane. The voxels beside a plane that are not flat hold its edge: their points are seen in an image on the plane, a
pixel being the greatest distance from it, and a corner is a pixel that none of the 24 around it exceeds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from revisit.core.scan import Points

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_SIDES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
_AROUND = np.array([[i, j] for i in range(-2, 3) for j in range(-2, 3) if (i, j) != (0, 0)])
_REACH = np.stack(np.meshgrid(*[np.arange(-3, 4)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
_HALF = 1 << 20


@dataclass(frozen=True)
class PlanarPieces:
    """Pieces of planes: centres (m, 3), unit normals (m, 3), and the plane (m,) each belongs to."""

    centres: Floats
    normals: Floats
    planes: Integers


@dataclass(frozen=True)
class Corners:
    """Corner points (k, 3) and the normals (k, 3) of the planes they were seen on, those farthest from them first."""

    points: Floats
    normals: Floats


@dataclass(frozen=True)
class PlaneEdges:
    """Points are thinned to one in `thinned_m`, voxels are `voxel_m` wide (the authors' values for KITTI).

    Flat: at least `fewest` points whose least variance is below `flat_m2` and the others are not; one plane: neighbours
    whose normals differ by less than `like`. Beside: at most `aside` voxels along the plane and `highest_m` from it.
    Images have pixels of `pixel_m`; corners are at least `least_m` from their plane and `spacing_m` apart, at most
    `most`.
    """

    thinned_m: float = 0.25
    voxel_m: float = 2.0
    fewest: int = 10
    flat_m2: float = 0.01
    like: float = 0.2
    pixel_m: float = 0.5
    aside: float = 1.5
    highest_m: float = 5.0
    least_m: float = 1.0
    spacing_m: float = 2.0
    most: int = 100

    def find(self, points: Points) -> tuple[PlanarPieces, Corners]:
        """The planes and the corners of a cloud (n, 3), metres; both may be empty."""
        thinned = _thinned(points, self.thinned_m)
        voxels, voxel_of = _voxels(thinned, self.voxel_m)
        centres, normals, flat = self._fitted(thinned, voxel_of, len(voxels))
        neighbours = _neighbours(voxels)
        planes = self._merged(centres, normals, flat, neighbours)
        pieces = PlanarPieces(centres[flat], normals[flat], planes[flat])
        beside = self._beside(voxels, flat, normals)
        if len(beside) == 0:
            return pieces, Corners(np.zeros((0, 3)), np.zeros((0, 3)))
        return pieces, self._corners(thinned, voxel_of, beside, (centres, normals, planes))

    def _fitted(self, points: Floats, voxel_of: Integers, count: int) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Centre and direction of least variance of each voxel (count, 3), and which are flat (count,)."""
        number = np.bincount(voxel_of, minlength=count).astype(np.float64)
        sums = [np.bincount(voxel_of, points[:, axis], count) for axis in range(3)]
        centres: Floats = np.stack(sums, axis=1) / number[:, None]
        off = points - centres[voxel_of]
        covariance = np.empty((count, 3, 3))
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
            covariance[:, i, j] = covariance[:, j, i] = np.bincount(voxel_of, off[:, i] * off[:, j], count) / number
        variance, axes = np.linalg.eigh(covariance)
        flat = (number >= self.fewest) & (variance[:, 0] < self.flat_m2) & (variance[:, 1] > self.flat_m2)
        return centres, axes[:, :, 0], flat

    def _merged(self, centres: Floats, normals: Floats, flat: NDArray[np.bool_], neighbours: Integers) -> Integers:
        """The number of the plane of every voxel (v,); a voxel that is not flat is alone."""
        a, b = neighbours[flat[neighbours].all(axis=1)].T
        like = np.linalg.norm(normals[a] - normals[b], axis=1), np.linalg.norm(normals[a] + normals[b], axis=1)
        apart = np.abs(np.einsum("nk,nk->n", centres[b] - centres[a], normals[a]))
        one = (np.minimum(*like) < self.like) & (apart < self.like * self.voxel_m)
        graph = coo_matrix((np.ones(one.sum()), (a[one], b[one])), shape=(len(flat), len(flat)))
        return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)

    def _beside(self, voxels: Integers, flat: NDArray[np.bool_], normals: Floats) -> Integers:
        """Pairs (b, 2): a voxel that is not flat, and a flat one it lies beside; those least aside first."""
        pieces, keys = np.flatnonzero(flat), _packed(voxels)
        around = _packed((voxels[pieces][:, None] + _REACH).reshape(-1, 3))
        at = np.minimum(np.searchsorted(keys, around), len(keys) - 1)
        piece, step = np.repeat(pieces, len(_REACH)), np.tile(_REACH, (len(pieces), 1))
        along = np.abs(np.einsum("nk,nk->n", step, normals[piece]))
        aside = np.sqrt(np.maximum((step**2).sum(axis=1) - along**2, 0.0))
        found = (keys[at] == around) & ~flat[at] & (aside < self.aside) & (along * self.voxel_m < self.highest_m)
        order = np.argsort(aside[found], kind="stable")
        return np.column_stack([at[found], piece[found]])[order]

    def _corners(
        self, points: Floats, voxel_of: Integers, beside: Integers, fitted: tuple[Floats, Floats, Integers]
    ) -> Corners:
        """Corners in the images of the planes. fitted: centres, normals and planes of the voxels, (v, ...) each."""
        centres, normals, planes = fitted
        # A voxel beside several pieces of one plane is seen by one of them only.
        _, first = np.unique(np.column_stack([beside[:, 0], planes[beside[:, 1]]]), axis=0, return_index=True)
        beside = beside[first]
        row, pair = _members(voxel_of, beside[:, 0])
        seen, piece = points[row], beside[pair, 1]
        _, one, plane = np.unique(planes[piece], return_index=True, return_inverse=True)
        plane, centre, normal = plane.ravel(), centres[piece[one]], normals[piece[one]]
        away = np.abs(np.einsum("nk,nk->n", seen - centres[piece], normals[piece]))
        axes = _axes(normal)[plane]
        pixel = np.floor(np.einsum("nak,nk->na", axes, seen - centre[plane]) / self.pixel_m).astype(np.int64)
        usable = np.flatnonzero((away >= self.least_m) & (away <= self.highest_m))
        tops = usable[_local_tops(plane[usable], pixel[usable], away[usable])]
        order = tops[np.argsort(-away[tops], kind="stable")]
        kept = order[spaced(seen[order], self.spacing_m)][: self.most]
        return Corners(seen[kept], normal[plane[kept]])


def spaced(points: Floats, spacing: float) -> NDArray[np.bool_]:
    """Which points (n, k) have no earlier kept one within `spacing`."""
    kept = np.zeros(len(points), dtype=bool)
    if len(points) == 0:
        return kept
    for index, near in enumerate(cKDTree(points).query_ball_point(points, spacing)):
        kept[index] = not any(kept[other] for other in near if other < index)
    return kept


def _thinned(points: Points, size: float) -> Floats:
    """The mean point of every cell of `size` metres, (m, 3)."""
    cells, cell_of = _voxels(points, size)
    number = np.bincount(cell_of, minlength=len(cells))
    return np.stack([np.bincount(cell_of, points[:, axis], len(cells)) / number for axis in range(3)], axis=1)


def _voxels(points: Floats | Points, size: float) -> tuple[Integers, Integers]:
    """The occupied voxels (v, 3), and the number (n,) of the one that holds each point."""
    key, voxel_of = np.unique(_packed(np.floor(points / size).astype(np.int64)), return_inverse=True)
    voxels = np.stack([key >> 42, (key >> 21) & (2 * _HALF - 1), key & (2 * _HALF - 1)], axis=1) - _HALF
    return voxels, voxel_of.ravel().astype(np.int64)


def _packed(indices: Integers) -> Integers:
    """One number for each row (n, 3) of indices within 2^20 of 0."""
    moved = indices + _HALF
    return np.asarray((moved[:, 0] << 42) | (moved[:, 1] << 21) | moved[:, 2])


def _neighbours(voxels: Integers) -> Integers:
    """Pairs (p, 2) of occupied voxels that share a face, both ways; `voxels` as of `_voxels`, in rising order."""
    keys = _packed(voxels)
    around = _packed((voxels[:, None] + _SIDES).reshape(-1, 3))
    at = np.minimum(np.searchsorted(keys, around), len(keys) - 1)
    found = keys[at] == around
    return np.column_stack([np.repeat(np.arange(len(voxels)), len(_SIDES))[found], at[found]])


def _members(voxel_of: Integers, wanted: Integers) -> tuple[Integers, Integers]:
    """The points of every wanted voxel (w,), one voxel after the other: rows of points, and which wanted voxel."""
    order = np.argsort(voxel_of, kind="stable")
    start = np.searchsorted(voxel_of[order], wanted)
    size = np.searchsorted(voxel_of[order], wanted, side="right") - start
    which = np.repeat(np.arange(len(wanted)), size)
    inside = np.arange(len(which)) - np.repeat(np.cumsum(size) - size, size)
    return order[start[which] + inside], which


def _axes(normals: Floats) -> Floats:
    """Two unit vectors (m, 2, 3) across each normal (m, 3)."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(normals, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normals, first)], axis=1)


def _local_tops(plane: Integers, pixel: Integers, away: Floats) -> Integers:
    """The points (t,) that are highest in their pixel (n, 2) and higher than all of the 24 pixels around it."""
    order = np.lexsort((-away, pixel[:, 1], pixel[:, 0], plane))
    key = _packed(np.column_stack([plane, pixel]))[order]
    first = np.ones(len(key), dtype=bool)
    first[1:] = key[1:] != key[:-1]
    top, key = order[first], key[first]
    highest = np.ones(len(top), dtype=bool)
    for step in _AROUND:
        other = key + (step[0] << 21) + step[1]
        at = np.minimum(np.searchsorted(key, other), max(len(key) - 1, 0))
        highest &= ~((key[at] == other) & (away[top[at]] > away[top]))
    return top[highest]
