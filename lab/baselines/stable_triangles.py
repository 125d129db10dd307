"""STD (Yuan et al., ICRA 2023): triangles between corners of plane edges vote for places; overlapping planes decide.

Re-implemented from the paper, with the parameters that its authors publish for KITTI. They join ten scans to a key
frame; here it is the submap. Chosen here: the number of candidates, and corners within `inlier_m` as those that agree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lab.baselines.plane_edges import Corners, PlaneEdges
from revisit.core.scan import Points
from revisit.evaluation.baselines.place_recogniser import Descriptor

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_SHAPE, _WIDTH = 6, 15
_CELLS = np.array([[i, j, k] for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)])
_VOTES_WEIGH = 1e-6
_FEWEST_PAIRS = 4


@dataclass(frozen=True)
class StableTriangles:
    """Each corner and two of its `near` nearest are a triangle, with sides of `side_m`, rounded to `side_step_m`.

    Triangles match where their sides differ by less than `side_share` of their length and the cosines between their
    normals by less than `normal_step`. The `candidates` places with most matches are aligned by the best of `poses`
    poses of matched triangles; a piece of a plane overlaps where the nearest one of the place has a normal within
    `like` and lies within `plane_m` of its plane. At most `triangles` and `pieces` are stored.
    """

    edges: PlaneEdges = PlaneEdges()
    near: int = 10
    side_m: tuple[float, float] = (2.0, 50.0)
    side_step_m: float = 0.2
    side_share: float = 0.01
    normal_step: float = 0.2
    candidates: int = 20
    poses: int = 50
    inlier_m: float = 1.0
    like: float = 0.2
    plane_m: float = 0.5
    triangles: int = 3000
    pieces: int = 1000

    @property
    def name(self) -> str:
        """The name of the method in reports."""
        return "std"

    def describe(self, points: Points) -> Descriptor:
        """(triangles + pieces, 15), NaN where there are fewer.

        Triangles: sides by rising length, cosines between the normals at their ends, corners opposite to the sides.
        Pieces of planes: centre and normal.
        """
        pieces, corners = self.edges.find(points)
        result = np.full((self.triangles + self.pieces, _WIDTH), np.nan, dtype=np.float32)
        rows = self._triangles(corners)[: self.triangles]
        result[: len(rows)] = rows
        planes = np.column_stack([pieces.centres, pieces.normals])
        # Where there are more pieces than are stored, they are taken evenly.
        planes = planes[np.linspace(0, len(planes) - 1, min(len(planes), self.pieces)).astype(np.int64)]
        result[self.triangles : self.triangles + len(planes), :_SHAPE] = planes
        return result

    def similarities(self, query: Descriptor, places: Descriptor) -> NDArray[np.float64]:
        """The share of the query's planes that overlap with those of a place; at most 1e-6 where it is no candidate."""
        asked = _present(query[: self.triangles])
        place, known, own = self._matches(asked, places[:, : self.triangles])
        votes = np.bincount(place, minlength=len(places))
        result = _VOTES_WEIGH * votes / max(int(votes.max(initial=0)), 1)
        pieces = _present(query[self.triangles :, :_SHAPE])
        for index in np.argsort(-votes, kind="stable")[: self.candidates]:
            chosen = place == index
            pose = self._pose(asked[own[chosen], _SHAPE:], places[index, known[chosen], _SHAPE:].astype(np.float64))
            if pose is not None:
                theirs = _present(places[index, self.triangles :, :_SHAPE])
                result[index] += (1 - _VOTES_WEIGH) * self._overlap(pose, pieces, theirs)
        return np.asarray(result)

    def _triangles(self, corners: Corners) -> Floats:
        """Rows (t, 15) as stored, each triangle once."""
        if len(corners.points) < 3:
            return np.zeros((0, _WIDTH))
        triples = neighbour_triples(corners.points, self.near)
        ends, normals = corners.points[triples], corners.normals[triples]
        sides = np.linalg.norm(ends[:, [1, 2, 0]] - ends[:, [2, 0, 1]], axis=2)
        order = np.argsort(sides, axis=1)
        sides = np.take_along_axis(sides, order, axis=1)
        ends, normals = (np.take_along_axis(part, order[:, :, None], axis=1) for part in (ends, normals))
        cosines = np.abs(np.einsum("tik,tik->ti", normals[:, [1, 2, 0]], normals[:, [2, 0, 1]]))
        usable = (sides[:, 0] >= self.side_m[0]) & (sides[:, 2] <= self.side_m[1])
        return np.concatenate([sides, cosines, ends.reshape(-1, 9)], axis=1)[usable]

    def _matches(self, asked: Floats, places: Descriptor) -> tuple[Integers, Integers, Integers]:
        """Matched triangles: the place, the triangle of the place and the query's own, (p,) each."""
        place, known = np.nonzero(~np.isnan(places[:, :, 0]))
        shapes = places[place, known, :_SHAPE]
        keys = self._key(np.floor(shapes[:, :3] / self.side_step_m).astype(np.int64))
        order = np.argsort(keys, kind="stable")
        cells = np.floor(asked[:, :3] / self.side_step_m).astype(np.int64)[:, None] + _CELLS
        wanted = self._key(cells.reshape(-1, 3))
        start = np.searchsorted(keys[order], wanted)
        size = np.searchsorted(keys[order], wanted, side="right") - start
        inside = np.arange(size.sum()) - np.repeat(np.cumsum(size) - size, size)
        other = order[np.repeat(start, size) + inside]
        own = np.repeat(np.repeat(np.arange(len(asked)), len(_CELLS)), size)
        difference = shapes[other] - asked[own, :_SHAPE].astype(np.float32)
        length = np.linalg.norm(asked[:, :3], axis=1)[own]
        same = np.linalg.norm(difference[:, :3], axis=1) < self.side_share * length
        same &= np.abs(difference[:, 3:]).max(axis=1, initial=0.0) < self.normal_step
        return place[other[same]], known[other[same]], own[same]

    @staticmethod
    def _key(steps: Integers) -> Integers:
        """One number for each three rounded sides (n, 3)."""
        return np.asarray(((steps[:, 0] + 1) << 40) | ((steps[:, 1] + 1) << 20) | (steps[:, 2] + 1))

    def _pose(self, asked: Floats, known: Floats) -> tuple[Floats, Floats] | None:
        """Rotation and translation on which most matched triangles (p, 9) agree; None where too few do."""
        if len(asked) < _FEWEST_PAIRS:
            return None
        first, second = asked.reshape(-1, 3, 3), known.reshape(-1, 3, 3)
        tried = np.unique(np.linspace(0, len(first) - 1, self.poses).astype(np.int64))
        turns, shifts = rigid_fits(first[tried], second[tried])
        moved = np.einsum("hij,pcj->hpci", turns, first) + shifts[:, None, None]
        agree = (np.linalg.norm(moved - second, axis=3) < self.inlier_m).all(axis=2)
        best = agree[int(agree.sum(axis=1).argmax())]
        if best.sum() < _FEWEST_PAIRS:
            return None
        turn, shift = rigid_fits(first[best].reshape(1, -1, 3), second[best].reshape(1, -1, 3))
        return turn[0], shift[0]

    def _overlap(self, pose: tuple[Floats, Floats], pieces: Floats, theirs: Floats) -> float:
        """The share of the query's pieces of planes (m, 6) that lie on those of a place, 0 to 1."""
        if len(pieces) == 0 or len(theirs) == 0:
            return 0.0
        turn, shift = pose
        centre, normal = pieces[:, :3] @ turn.T + shift, pieces[:, 3:] @ turn.T
        near = theirs[cKDTree(theirs[:, :3]).query(centre)[1]]
        alike = np.minimum(*(np.linalg.norm(normal + sign * near[:, 3:], axis=1) for sign in (1, -1))) < self.like
        away = np.abs(np.einsum("mk,mk->m", centre - near[:, :3], near[:, 3:]))
        return float(np.mean(alike & (away < self.plane_m)))


def neighbour_triples(points: Floats, neighbours: int) -> Integers:
    """Indices (t, 3) of every point with every two of its nearest, each triangle once."""
    near = cKDTree(points).query(points, k=min(neighbours + 1, len(points)))[1][:, 1:]
    i, j = np.triu_indices(near.shape[1], k=1)
    triples = np.stack([np.repeat(np.arange(len(points)), len(i)), near[:, i].ravel(), near[:, j].ravel()], axis=1)
    _, first = np.unique(np.sort(triples, axis=1), axis=0, return_index=True)
    return np.asarray(triples[np.sort(first)])


def _present(rows: Descriptor) -> Floats:
    """The rows that hold something."""
    return rows[~np.isnan(rows[:, 0])].astype(np.float64)


def rigid_fits(first: Floats, second: Floats) -> tuple[Floats, Floats]:
    """Rotations (h, 3, 3) and translations (h, 3) that carry points (h, n, 3) onto others with least squares."""
    middle_1, middle_2 = first.mean(axis=1), second.mean(axis=1)
    product = np.einsum("hni,hnj->hij", first - middle_1[:, None], second - middle_2[:, None])
    u, _, vt = np.linalg.svd(product)
    v = vt.transpose(0, 2, 1)
    v[:, :, 2] *= np.sign(np.linalg.det(v @ u.transpose(0, 2, 1)))[:, None]
    turns = v @ u.transpose(0, 2, 1)
    return turns, middle_2 - np.einsum("hij,hj->hi", turns, middle_1)
