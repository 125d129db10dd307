"""LinK3D (Cui et al., 2022): key points where rough returns of many scan lines stand together, described by the others.

Re-implemented from the paper, with the numbers of its authors' published programme for KITTI. Here a return that joins
no cluster always starts one, and clusters are merged in one pass from the first on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lab.baselines.link3d_loops import join_clusters, merge_clusters, shared_distances
from lab.baselines.scan_lines import Floats, Integers, ScanLines, roughness, scan_lines
from revisit.core.scan import Points

SECTORS = 180
STEPS_PER_METRE = 10
_FAR = np.iinfo(np.int16).max

Descriptors = NDArray[np.int16]


@dataclass(frozen=True)
class Edges:
    """Rough returns: points (e, 3) metres, their line (e,), their roughness (e,), and the cluster they are in (e,)."""

    points: Floats
    line: Integers
    roughness: Floats
    cluster: Integers

    def of(self, rows: NDArray[np.bool_] | Integers) -> Edges:
        """Some of them."""
        return Edges(self.points[rows], self.line[rows], self.roughness[rows], self.cluster[rows])


@dataclass(frozen=True)
class LinkFeatures:
    """Key points (k, 3) by their distance from the sensor, their descriptors (k, 180), and the edges they are made of.

    A descriptor holds distances in steps of 0.1 m, 0 for none. Edges: the roughest return of each line of each key
    point; their `cluster` is the row of the key point.
    """

    points: Floats
    descriptors: Descriptors
    edges: Edges


@dataclass(frozen=True)
class Link3d:
    """Returns are rough between `rough_m2`, `reach` neighbours to each side; lengths in metres.

    Within each of `areas` sectors of the view a return joins the first cluster whose mean x, y and distance are within
    `join_m`; clusters within twice that are merged. A key point has at least a sixth of the sensor's lines and one and
    a half times as many returns. Two key points match where at least `fewest` distances differ by at most `apart_m`.
    """

    reach: int = 5
    rough_m2: tuple[float, float] = (10.0, 20_000.0)
    areas: int = 120
    join_m: float = 0.4
    apart_m: float = 0.2
    fewest: int = 6

    def features(self, points: Points, elevations_deg: Sequence[float]) -> LinkFeatures:
        """The features of one scan (n, 3), metres, in the frame of a sensor with beams of these elevations (b,)."""
        edges = self._clustered(self.edges(scan_lines(points, elevations_deg)))
        lines = len(elevations_deg) // 6
        edges = _large(edges, lines, int(np.ceil(1.5 * lines)))
        count = int(edges.cluster.max(initial=-1)) + 1
        size = np.maximum(np.bincount(edges.cluster, minlength=count), 1)[:, None]
        middle = np.stack([np.bincount(edges.cluster, axis, count) for axis in edges.points.T], axis=1) / size
        order = np.argsort(np.linalg.norm(middle, axis=1), kind="stable")
        rank = np.empty(count, dtype=np.int64)
        rank[order] = np.arange(count)
        ranked = Edges(edges.points, edges.line, edges.roughness, rank[edges.cluster])
        return LinkFeatures(middle[order], descriptors(middle[order]), _roughest(ranked))

    def edges(self, lines: ScanLines) -> Edges:
        """The rough returns of a scan, in no cluster yet (-1)."""
        rough = roughness(lines, self.reach)
        rows = np.flatnonzero((rough > self.rough_m2[0]) & (rough < self.rough_m2[1]))
        return Edges(lines.points[rows], lines.line[rows], rough[rows], np.full(len(rows), -1))

    def matches(self, first: Descriptors, second: Descriptors) -> Integers:
        """Pairs (p, 2) of rows of two sets of descriptors (k, 180): each of the first has its best of the second, each
        of the second at most one."""
        if len(first) == 0 or len(second) == 0:
            return np.zeros((0, 2), dtype=np.int64)
        alike = shared_distances(first, second, round(self.apart_m * STEPS_PER_METRE))
        best = alike.argmax(axis=1)
        score = alike[np.arange(len(first)), best]
        order = np.lexsort((np.arange(len(first)), -score))
        _, once = np.unique(best[order], return_index=True)
        kept = np.sort(order[once])
        kept = kept[score[kept] >= self.fewest]
        return np.stack([kept, best[kept]], axis=1)

    def _clustered(self, edges: Edges) -> Edges:
        """Each return in a cluster of its sector of the view; near clusters as one."""
        azimuth = np.arctan2(edges.points[:, 1], edges.points[:, 0]) % (2 * np.pi)
        area = np.minimum((azimuth / (2 * np.pi) * self.areas).astype(np.int64), self.areas - 1)
        order = np.argsort(area, kind="stable")
        plan = np.column_stack([edges.points[:, :2], np.hypot(*edges.points[:, :2].T)])
        cluster = np.empty(len(area), dtype=np.int64)
        cluster[order] = join_clusters(plan[order], area[order], self.join_m)
        size = np.bincount(cluster)
        means = np.stack([np.bincount(cluster, axis, len(size)) for axis in plan.T], axis=1) / size[:, None]
        merged = merge_clusters(means, size, 2 * self.join_m)[cluster]
        return Edges(edges.points, edges.line, edges.roughness, merged)


def descriptors(points: Floats) -> Descriptors:
    """Of each key point (k, 3): the distance to the nearest other one in each of 180 sectors, from the nearest on.

    Sectors are 2 degrees wide and follow, seen from above, the direction to the nearest key point, whose distance comes
    first. Where a sector is empty, the second nearest gives the direction, then the third.
    """
    count, mains = len(points), min(3, len(points) - 1)
    if count < 2:
        return np.zeros((count, SECTORS), dtype=np.int16)
    apart = points[None] - points[:, None]
    steps = np.round(np.linalg.norm(apart, axis=2) * STEPS_PER_METRE).astype(np.int16)
    azimuth = np.arctan2(apart[:, :, 1], apart[:, :, 0])
    near = np.argsort(np.where(np.eye(count, dtype=bool), _FAR, steps), axis=1, kind="stable")[:, :mains]
    own = np.arange(count)[:, None]
    turned = azimuth[:, None] - azimuth[own, near][:, :, None]
    sector = np.round(np.degrees(turned) / 2).astype(np.int64) % SECTORS
    table = np.full((count, mains, SECTORS), _FAR, dtype=np.int16)
    i, m, j = np.nonzero((sector > 0) & ~np.eye(count, dtype=bool)[:, None])
    np.minimum.at(table, (i, m, sector[i, m, j]), steps[i, j])
    table[:, :, 0] = steps[own, near]
    first = (table < _FAR).argmax(axis=1)[:, None]
    chosen = np.take_along_axis(table, first, axis=1)[:, 0]
    return np.asarray(np.where(chosen < _FAR, chosen, 0), dtype=np.int16)


def _large(edges: Edges, lines: int, returns: int) -> Edges:
    """Clusters of at least so many lines and returns, numbered anew."""
    count = int(edges.cluster.max(initial=-1)) + 1
    pairs = np.unique(np.stack([edges.cluster, edges.line], axis=1), axis=0)
    kept = np.bincount(pairs[:, 0], minlength=count) >= lines
    kept &= np.bincount(edges.cluster, minlength=count) >= returns
    chosen = edges.of(kept[edges.cluster])
    return Edges(chosen.points, chosen.line, chosen.roughness, (np.cumsum(kept) - 1)[chosen.cluster])


def _roughest(edges: Edges) -> Edges:
    """The roughest return of each line of each cluster, by cluster and line."""
    ordered = edges.of(np.lexsort((-edges.roughness, edges.line, edges.cluster)))
    _, first = np.unique(np.stack([ordered.cluster, ordered.line], axis=1), axis=0, return_index=True)
    return ordered.of(first)
