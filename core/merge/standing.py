"""The points that still stand: those that no later drive looked through, or that a drive has seen since.

Every point was last seen by some visit and last looked through by some other; the later of the two decides. A drive
says nothing against its own points: what moves within one drive is for the dynamic filter of its submaps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from revisit.core.merge.fused import PlacedMap
from revisit.core.merge.things import are_in, thing_of_many, voxels_of
from revisit.core.merge.visits import Visit, visits_of

Rows = NDArray[np.int64]

FOOT = 1.5
"""So many voxels around a thing that has gone lie its feet."""


def still_standing(maps: Sequence[PlacedMap], half_m: float = np.inf) -> list[PlacedMap]:
    """The maps without the points that were looked through since they were seen last.

    Those of one drive are as they were. Judged are points within `half_m` of the middle of the frame, along x and y.
    """
    if len({one.session for one in maps}) < 2:
        return list(maps)
    return [one.only(stands) for one, stands in zip(maps, standing(maps, half_m), strict=True)]


def standing(maps: Sequence[PlacedMap], half_m: float = np.inf) -> list[NDArray[np.bool_]]:
    """Which points (n,) of each map still stand as of the latest of them.

    Single points that were looked through are noise of the surface: a thing must have gone (`things`).
    """
    stands = [np.ones(len(one.neural_map.points), dtype=bool) for one in maps]
    visits = visits_of(maps, half_m)
    if len({one.session for one in visits}) < 2:
        return stands
    gone = _gone(visits)
    start = 0
    for visit in visits:
        for row, own in zip(visit.rows, visit.of_maps, strict=True):
            stands[row][own] = ~gone[start : start + len(own)]
            start += len(own)
    return stands


@dataclass(frozen=True)
class _Seen:
    """The points (n, 3) of all visits, one after another; the session and the visit of each, and when it was seen."""

    visits: Sequence[Visit]
    points: NDArray[np.float64]
    session: Rows
    visit: Rows
    stamps_ns: Rows


def _gone(visits: Sequence[Visit]) -> NDArray[np.bool_]:
    """Which points (n,) of all visits no longer stand: those of things that were looked through, and their feet."""
    sizes = [len(one.points) for one in visits]
    session, number = (np.repeat(its, sizes) for its in ([one.session for one in visits], np.arange(len(visits))))
    points, stamps_ns = (
        np.concatenate(parts) for parts in zip(*((one.points, one.stamps_ns) for one in visits), strict=True)
    )
    seen = _Seen(visits, points, session, number, stamps_ns)
    gone_by = _looked_through_by(seen)
    rows = np.flatnonzero(gone_by >= 0)
    things = thing_of_many(seen.points[rows], visits[0].resolution_m, visits[0].scale)
    gone_by[rows[things < 0]] = -1
    return (gone_by >= 0) | _above(seen, gone_by, rows, things) | _at_its_foot(seen, gone_by)


def _looked_through_by(seen: _Seen) -> Rows:
    """The visit (n,) that looked through each point after it was seen last; -1 where none did."""
    gone_by, open_rows = np.full(len(seen.points), -1), np.arange(len(seen.points))
    for number in range(len(seen.visits) - 1, 0, -1):
        visit = seen.visits[number]
        earlier = open_rows[seen.visit[open_rows] < number]
        unseen = earlier[~visit.has(seen.points[earlier])]
        others = unseen[seen.session[unseen] != visit.session]
        gone_by[others[visit.looked_through(seen.points[others], seen.stamps_ns[others])]] = number
        open_rows = unseen[gone_by[unseen] < 0]
    return gone_by


def _above(seen: _Seen, gone_by: Rows, rows: Rows, things: Rows) -> NDArray[np.bool_]:
    """Which points (n,) were the upper part of one of the `things`, of which the points in `rows` have gone.

    Above a sensor rays meet nothing behind a thing, so that nobody looks through it. Such a point stood over what has
    gone, no higher above it than that is high, was connected with it, and no visit has seen it since.
    """
    above, edge_m = np.zeros(len(seen.points), dtype=bool), seen.visits[0].resolution_m
    rows, things = rows[things >= 0], things[things >= 0]
    if not len(rows):
        return above
    others = np.flatnonzero((gone_by < 0) & (seen.points[:, 2] >= seen.points[rows, 2].min()))
    ground = seen.points * (1.0, 1.0, 0.0)
    others = others[_may_be_near(ground[others], ground[rows], edge_m)]
    for thing in range(things.max() + 1):
        its = rows[things == thing]
        low, high, since = seen.points[its].min(axis=0), seen.points[its].max(axis=0), gone_by[its].max()
        least, most = low - (0.5 * edge_m, 0.5 * edge_m, 0.0), high + (0.5 * edge_m, 0.5 * edge_m, high[2] - low[2])
        is_over = ((seen.points[others] >= least) & (seen.points[others] <= most)).all(axis=1)
        some = _unseen_since(seen, others[is_over], since)
        joined = thing_of_many(seen.points[np.concatenate([some, its])], edge_m, seen.visits[0].scale)
        above[some[np.isin(joined[: len(some)], joined[len(some) :])]] = True
    return above


def _unseen_since(seen: _Seen, rows: Rows, number: int) -> Rows:
    """Those of the points in `rows` that a visit of this number, and later ones, did not see; its own are none."""
    rows = rows[(seen.visit[rows] < number) & (seen.session[rows] != seen.visits[number].session)]
    for visit in seen.visits[number:]:
        rows = rows[~visit.has(seen.points[rows])]
    return rows


def _may_be_near(points: NDArray[np.float64], some: NDArray[np.float64], reach_m: float) -> NDArray[np.bool_]:
    """Which points (n, 3) may be nearer than `reach_m` to one of `some`: all that are, and few others."""
    steps = np.stack(np.meshgrid(*[[-reach_m, 0.0, reach_m]] * 3), axis=-1).reshape(-1, 3)
    around = np.unique(np.concatenate([voxels_of(some + step, reach_m) for step in steps]))
    return are_in(voxels_of(points, reach_m), around)


def _at_its_foot(seen: _Seen, gone_by: Rows) -> NDArray[np.bool_]:
    """Which points (n,) stood with a thing that has gone, so near to what stands that rays pass by no better.

    A visit since then saw a surface beside them, and none saw one that they lie on.
    """
    feet, rows = np.zeros(len(seen.points), dtype=bool), np.flatnonzero(gone_by >= 0)
    if not len(rows):
        return feet
    reach_m = FOOT * seen.visits[0].resolution_m
    others = np.flatnonzero(_may_be_near(seen.points, seen.points[rows], reach_m) & (gone_by < 0))
    gaps, nearest = cKDTree(seen.points[rows]).query(seen.points[others], distance_upper_bound=reach_m)
    near, since = others[np.isfinite(gaps)], gone_by[rows[nearest[np.isfinite(gaps)]]]
    on, beside = np.zeros(len(near), dtype=bool), np.zeros(len(near), dtype=bool)
    for number, visit in enumerate(seen.visits):
        later = (since <= number) & (seen.visit[near] < since) & (seen.session[near] != visit.session)
        on[later], beside[later] = (
            before | found
            for before, found in zip(
                (on[later], beside[later]), visit.has_beside(seen.points[near[later]]), strict=True
            )
        )
    feet[near[beside & ~on]] = True
    return feet
