"""STD-like triangles (after Yuan et al., ICRA 2023): triangles between key points vote for places and poses.

Re-implemented from the paper's idea, not its code: key points are posts, ends and corners of upright things seen from
above (the paper projects the edges of planes), triangles are known by their side lengths, and the triangles that two
places share must agree on one pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lab.baselines.plane_edges import spaced
from lab.baselines.stable_triangles import neighbour_triples
from revisit.core.scan import Points
from revisit.evaluation.baselines.place_recogniser import Descriptor

Floats = NDArray[np.float64]

_SIDES, _CORNERS = 3, 6
_ONE_SIDED = 0.25
_POST_PIXELS = 4


@dataclass(frozen=True)
class Triangles:
    """Key points are upright pixels of `pixel_m`, at least `spacing_m` apart; triangles join each to its `neighbours`.

    A pixel is upright above `min_rise_m`, and a key point where its surroundings within `around_m` lie to one side.

    Side lengths of `side_m` are rounded to `side_step_m`; poses that agree within `pose_step_m` and `yaw_step_deg`
    vote together. `vote_candidates` places that share most triangles are examined for agreement.
    """

    pixel_m: float = 0.5
    spacing_m: float = 2.0
    min_rise_m: float = 1.0
    around_m: float = 2.5
    max_range_m: float = 60.0
    key_points: int = 120
    neighbours: int = 8
    side_m: tuple[float, float] = (3.0, 40.0)
    side_step_m: float = 0.5
    pose_step_m: float = 2.0
    yaw_step_deg: float = 6.0
    vote_candidates: int = 30
    most: int = 1500

    @property
    def name(self) -> str:
        """The name of the method in reports."""
        return "std-like-triangles"

    def describe(self, points: Points) -> Descriptor:
        """(most, 9): side lengths by rising size, and the corners x, y opposite to them; NaN where there are fewer."""
        keys = self._key_points(points.astype(np.float64))
        result = np.full((self.most, _SIDES + _CORNERS), np.nan, dtype=np.float32)
        if len(keys) < 3:
            return result
        corners = keys[neighbour_triples(keys, self.neighbours)]
        sides = np.linalg.norm(corners[:, [1, 2, 0]] - corners[:, [2, 0, 1]], axis=2)
        # Sides of a step apart tell the corners of one triangle from another's; longer ones are too rare to be met.
        order = np.argsort(sides, axis=1)
        sides = np.take_along_axis(sides, order, axis=1)
        corners = np.take_along_axis(corners, order[:, :, None], axis=1)
        apart = np.diff(sides, axis=1).min(axis=1) > self.side_step_m
        usable = apart & (sides[:, 0] >= self.side_m[0]) & (sides[:, 2] <= self.side_m[1])
        rows = np.concatenate([sides[usable], corners[usable].reshape(-1, _CORNERS)], axis=1)[: self.most]
        result[: len(rows)] = rows
        return result

    def similarities(self, query: Descriptor, places: Descriptor) -> NDArray[np.float64]:
        """Share of the query's triangles that a place has in one pose; 0 where the shared triangles are few."""
        keys = self._keys(query)
        votes = np.array([np.isin(self._keys(place), keys).sum() for place in places])
        result = np.zeros(len(places))
        count = max(len(keys), 1)
        for index in np.argsort(-votes, kind="stable")[: self.vote_candidates]:
            result[index] = self._agreeing(query, places[index]) / count
        return np.minimum(result, 1.0)

    def _key_points(self, points: Floats) -> Floats:
        """Positions (k, 2) of posts, ends and corners, the clearest first."""
        near = points[np.hypot(points[:, 0], points[:, 1]) < self.max_range_m]
        pixel, index = np.unique(np.floor(near[:, :2] / self.pixel_m).astype(np.int64), axis=0, return_inverse=True)
        index = index.ravel()
        top, bottom = np.full(len(pixel), -np.inf), np.full(len(pixel), np.inf)
        np.maximum.at(top, index, near[:, 2])
        np.minimum.at(bottom, index, near[:, 2])
        centre: Floats = np.stack([np.bincount(index, near[:, axis]) for axis in (0, 1)], axis=1, dtype=np.float64)
        centre /= np.maximum(np.bincount(index, minlength=len(pixel)), 1)[:, None]
        upright = centre[top - bottom > self.min_rise_m]
        clearness = _one_sidedness(upright, self.around_m)
        order = np.argsort(-clearness, kind="stable")
        clear: Floats = upright[order[clearness[order] > _ONE_SIDED]]
        return clear[spaced(clear, self.spacing_m)][: self.key_points]

    def _keys(self, rows: Descriptor) -> NDArray[np.int64]:
        """One number a triangle, from its rounded sides."""
        sides = rows[~np.isnan(rows[:, 0]), :_SIDES].astype(np.float64)
        steps = np.floor(sides / self.side_step_m).astype(np.int64)
        return np.asarray((steps[:, 0] * 1000 + steps[:, 1]) * 1000 + steps[:, 2])

    def _agreeing(self, query: Descriptor, place: Descriptor) -> int:
        """How many pairs of equal triangles imply the commonest pose of the query in the place."""
        asked, known = (rows[~np.isnan(rows[:, 0])].astype(np.float64) for rows in (query, place))
        pairs = _equal_pairs(self._keys(query), self._keys(place))
        if len(pairs) == 0:
            return 0
        first = asked[pairs[:, 0], _SIDES:].reshape(-1, 3, 2)
        second = known[pairs[:, 1], _SIDES:].reshape(-1, 3, 2)
        yaw, shift = _planar_fits(first, second)
        cell = np.column_stack([np.mod(yaw, 2 * np.pi) / np.radians(self.yaw_step_deg), shift / self.pose_step_m])
        # A pose near the edge of a cell would split its votes: the grid is tried in two places.
        counts = [np.unique(np.floor(cell + half).astype(np.int64), axis=0, return_counts=True)[1].max()
                  for half in (0.0, 0.5)]  # fmt: skip
        return int(max(counts))


def _one_sidedness(points: Floats, radius: float) -> Floats:
    """How far the points (n, 2) within `radius` lie to one side of each, over the radius; 1 where there are few.

    0 in the middle of a wall, about 1/2 at its end, less at a corner.
    """
    if len(points) == 0:
        return np.zeros(0)
    neighbours = cKDTree(points).query_ball_point(points, radius)
    offset = np.array([np.linalg.norm(points[near].mean(axis=0) - points[i]) for i, near in enumerate(neighbours)])
    alone = np.array([len(near) <= _POST_PIXELS for near in neighbours])
    return np.where(alone, 1.0, offset / radius)


def _equal_pairs(first: NDArray[np.int64], second: NDArray[np.int64]) -> NDArray[np.int64]:
    """Indices (p, 2) of equal numbers in two arrays."""
    order = np.argsort(second, kind="stable")
    low = np.searchsorted(second[order], first, side="left")
    high = np.searchsorted(second[order], first, side="right")
    pairs = [(index, int(order[at])) for index, (a, b) in enumerate(zip(low, high, strict=True)) for at in range(a, b)]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _planar_fits(first: Floats, second: Floats) -> tuple[Floats, Floats]:
    """Yaw (p,) and translation (p, 2) that carry each triangle (p, 3, 2) onto the other with least squares."""
    middle_1, middle_2 = first.mean(axis=1), second.mean(axis=1)
    a, b = first - middle_1[:, None], second - middle_2[:, None]
    sine = (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).sum(axis=1)
    yaw = np.arctan2(sine, (a * b).sum(axis=(1, 2)))
    c, s = np.cos(yaw), np.sin(yaw)
    turned = np.stack([c * middle_1[:, 0] - s * middle_1[:, 1], s * middle_1[:, 0] + c * middle_1[:, 1]], axis=1)
    return yaw, middle_2 - turned
