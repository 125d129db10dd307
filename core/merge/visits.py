"""Visits: what one drive saw of a place at one time, and what it looked through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from revisit.core.merge.evidence import CHANGE_REACH_M, DATED_NS, in_time
from revisit.core.merge.fused import PlacedMap
from revisit.core.merge.overlap import looked_through, normals_in_map, points_in_map, seen_from_map
from revisit.core.merge.things import are_in, voxels_of

Array64 = NDArray[np.float64]

ON_SURFACE = 0.35
"""A point lies on a surface nearer to its tangent plane than this share of the resolution."""

GAP_NS = 600 * 10**9
LONGEST_NS = 3600 * 10**9
"""A drive that pauses for longer, or lasts longer, is more than one visit."""


@dataclass(frozen=True)
class Visit:
    """Submaps of one session, taken one after another; `rows` are theirs among the maps that were given.

    Its points are those within `half_m` of the middle of the frame, along x and along y.
    """

    session: int
    maps: tuple[PlacedMap, ...]
    rows: tuple[int, ...]
    half_m: float = np.inf

    @property
    def stamp_ns(self) -> int:
        """When it ended."""
        return max(one.stamp_ns for one in self.maps)

    @cached_property
    def stamps_ns(self) -> NDArray[np.int64]:
        """When the submap of each of its points was taken (n,)."""
        sizes = [len(rows) for rows in self.of_maps]
        return np.repeat(np.array([one.stamp_ns for one in self.maps], np.int64), sizes)

    @property
    def scale(self) -> float:
        """That of the scene."""
        return self.maps[0].neural_map.frame.scale

    @property
    def resolution_m(self) -> float:
        """Of its neural maps, metres."""
        return self.maps[0].neural_map.config.resolution * self.scale

    @cached_property
    def of_maps(self) -> tuple[NDArray[np.int64], ...]:
        """Which of the points of each of its submaps are its own."""
        return tuple(np.flatnonzero(np.abs(one[:, :2]).max(axis=1) < self.half_m) for one in self._whole)

    @cached_property
    def points(self) -> Array64:
        """Its points (n, 3) in the map, metres, submap by submap."""
        return np.concatenate([one[rows] for one, rows in zip(self._whole, self.of_maps, strict=True)])

    @property
    def _edge_m(self) -> float:
        """Of voxels so small that two points in one are nearer than the resolution."""
        return float(0.999 * self.resolution_m / np.sqrt(3.0))

    @cached_property
    def _voxels(self) -> NDArray[np.int64]:
        return np.unique(voxels_of(self.points, self._edge_m))

    @cached_property
    def _normals(self) -> Array64:
        """Those (n, 3) of its points."""
        of_maps = zip(self.maps, self.of_maps, strict=True)
        return np.concatenate([normals_in_map(one)[rows] for one, rows in of_maps])

    @cached_property
    def _whole(self) -> list[Array64]:
        return [points_in_map(one) for one in self.maps]

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.points)

    def has(self, points: Array64) -> NDArray[np.bool_]:
        """Which points (n, 3) of the map, metres, lie on what it saw."""
        if not len(self.points):
            return np.zeros(len(points), dtype=bool)
        has = are_in(voxels_of(points, self._edge_m), self._voxels)
        rest = np.flatnonzero(~has)
        gaps, _ = self._tree.query(points[rest], distance_upper_bound=self.resolution_m)
        has[rest] = np.isfinite(gaps)
        return has

    def has_beside(self, points: Array64) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Which points (n, 3) lie on a surface that it saw; and which beside one, near it but off its tangent plane."""
        if not len(self.points):
            return np.zeros(len(points), dtype=bool), np.zeros(len(points), dtype=bool)
        gaps, nearest = self._tree.query(points, distance_upper_bound=self.resolution_m)
        rows = np.flatnonzero(np.isfinite(gaps))
        its = nearest[rows]
        aside = np.abs(np.einsum("ni,ni->n", self._normals[its], points[rows] - self.points[its]))
        on, beside = np.zeros(len(points), dtype=bool), np.zeros(len(points), dtype=bool)
        on[rows], beside[rows] = aside < ON_SURFACE * self.resolution_m, aside >= ON_SURFACE * self.resolution_m
        return on, beside

    def looked_through(
        self, points: Array64, stamps_ns: NDArray[np.int64], *, sooner: bool = False
    ) -> NDArray[np.bool_]:
        """Which points (n, 3) of the map, metres, stood before what it saw later than they were seen, or `sooner`.

        Two robots may drive at one time: what one of them saw before a point was there says nothing against it.
        """
        through = np.zeros(len(points), dtype=bool)
        for one in self.maps:
            reach = np.linalg.norm(points - one.T_map_submap[:3, 3], axis=1) < 1.5 * CHANGE_REACH_M * self.scale
            if one.stamp_ns >= DATED_NS:
                reach &= stamps_ns > one.stamp_ns if sooner else stamps_ns < one.stamp_ns
            rows = np.flatnonzero(reach & ~through)
            positions = seen_from_map(points[rows], one)
            near = np.linalg.norm(positions, axis=1) < CHANGE_REACH_M
            through[rows[near]] = looked_through(positions[near], one)
        return through


def visits_of(maps: Sequence[PlacedMap], half_m: float = np.inf) -> list[Visit]:
    """The visits that submaps are of, in the order of time; those without points are of none."""
    known = [row for row, one in enumerate(maps) if len(one.neural_map.points)]
    order = sorted(known, key=lambda row: (maps[row].session, maps[row].stamp_ns, row))
    parts: list[list[int]] = []
    for row in order:
        if parts and _goes_on(maps[parts[-1][0]], maps[parts[-1][-1]], maps[row]):
            parts[-1].append(row)
        else:
            parts.append([row])
    visits = [Visit(maps[part[0]].session, tuple(maps[row] for row in part), tuple(part), half_m) for part in parts]
    return sorted(visits, key=lambda one: in_time(one.session, one.stamp_ns))


def _goes_on(first: PlacedMap, last: PlacedMap, one: PlacedMap) -> bool:
    """Whether a submap is of the visit that began with `first` and has come to `last`."""
    return (
        one.session == first.session
        and one.stamp_ns - last.stamp_ns <= GAP_NS
        and one.stamp_ns - first.stamp_ns <= LONGEST_NS
    )
