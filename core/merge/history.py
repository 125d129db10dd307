"""What changed from drive to drive: things that appeared, vanished, moved, or came back.

Visits are taken in the order of time. Each is compared with what stood when it came: what it looked through has
vanished; what it saw where former ones had looked through has appeared.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from revisit.core.merge.evidence import ChangedThing, ChangeKind, DatedChange, Vector
from revisit.core.merge.fused import PlacedMap
from revisit.core.merge.things import thing_of_many
from revisit.core.merge.visits import Visit, visits_of

Array64 = NDArray[np.float64]

MOST_CHANGES = 500

MOVED_M = 10.0
ALIKE = 0.35
"""A thing has moved that vanished nearer than this, metres in a scene of the size of a street, to one that appeared
whose edges differ from its own by no more than this share."""


@dataclass(frozen=True)
class _Points:
    """Points (n, 3) that stand or stood; of which session they are, and when they were seen, (n,)."""

    positions: Array64
    sessions: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]

    def __getitem__(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> _Points:
        return _Points(self.positions[rows], self.sessions[rows], self.stamps_ns[rows])

    def near(self, points: Array64, reach_m: float) -> NDArray[np.bool_]:
        """Which of the points (m, 3) lie near one of these."""
        if not len(self.positions):
            return np.zeros(len(points), dtype=bool)
        gaps, _ = cKDTree(self.positions).query(points, distance_upper_bound=reach_m)
        return np.asarray(np.isfinite(gaps))

    def and_those_of(self, visit: Visit) -> _Points:
        """With the points of a visit."""
        count = len(visit.points)
        return self + _Points(visit.points, np.full(count, visit.session), visit.stamps_ns)

    def __add__(self, other: _Points) -> _Points:
        return _Points(
            np.concatenate([self.positions, other.positions]),
            np.concatenate([self.sessions, other.sessions]),
            np.concatenate([self.stamps_ns, other.stamps_ns]),
        )


_NONE = _Points(np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(0, np.int64))


def changes_over_time(maps: Sequence[PlacedMap], half_m: float = np.inf) -> list[DatedChange]:
    """The changes that each drive found, in the order of time, the largest first.

    Judged are points within `half_m` of the middle of the frame, along x and along y.
    """
    found = [one for left, new in _by_visit(visits_of(maps, half_m)) for one in _with_moves(left, new, _scale(maps))]
    return sorted(found, key=lambda one: (one.stamp_ns, *_largest_first(one.thing)))


def changes_between(pairs: Sequence[tuple[PlacedMap, PlacedMap]]) -> list[ChangedThing]:
    """Changes from the first day to the second, the largest first; each pair has a submap of both days."""
    days = [{pair[day].T_map_submap.tobytes(): pair[day] for pair in pairs} for day in (0, 1)]
    maps = [replace(one, session=day, stamp_ns=day) for day, some in enumerate(days) for one in some.values()]
    found = [one.thing for left, new in _by_visit(visits_of(maps)) for one in (*left, *new)]
    return sorted(found, key=_largest_first)[:MOST_CHANGES]


def _by_visit(visits: Sequence[Visit]) -> Iterator[tuple[list[DatedChange], list[DatedChange]]]:
    """What has vanished when each visit came, and what has appeared."""
    standing, gone = _NONE, _NONE
    for number, visit in enumerate(visits):
        unseen = standing[~visit.has(standing.positions)]
        vanished = _vanished(visit, unseen)
        yield (
            [
                _change(ChangeKind.VANISHED, visit, unseen[vanished == one])
                for one in range(vanished.max(initial=-1) + 1)
            ],
            list(_appeared(visit, visits[:number], standing, gone)),
        )
        gone += unseen[vanished >= 0]
        standing = unseen[vanished < 0].and_those_of(visit)


def _scale(maps: Sequence[PlacedMap]) -> float:
    """That of the scene."""
    return maps[0].neural_map.frame.scale if maps else 1.0


def _largest_first(thing: ChangedThing) -> tuple[int, str, Vector]:
    return -thing.points, thing.kind, thing.centre_m


def _vanished(visit: Visit, unseen: _Points) -> NDArray[np.int64]:
    """The thing (n,) that has vanished with each of the points of others that a visit did not see; -1 for none."""
    through = unseen.sessions != visit.session
    rows = np.flatnonzero(through)
    rows = rows[visit.looked_through(unseen.positions[rows], unseen.stamps_ns[rows])]
    things = np.full(len(unseen.positions), -1)
    things[rows] = thing_of_many(unseen.positions[rows], visit.resolution_m, visit.scale)
    return things


def _appeared(visit: Visit, former: Sequence[Visit], standing: _Points, gone: _Points) -> Iterator[DatedChange]:
    """The things of a visit that stand where former visits of others looked through."""
    is_fresh = ~standing.near(visit.points, visit.resolution_m)
    fresh, stamps_ns = visit.points[is_fresh], visit.stamps_ns[is_fresh]
    seen_ns = np.full(len(fresh), -1)
    for one in former:
        if one.session != visit.session:
            seen_ns[one.looked_through(fresh, stamps_ns, sooner=True)] = one.stamp_ns
    new, before_ns = fresh[seen_ns >= 0], seen_ns[seen_ns >= 0]
    things, was_here = thing_of_many(new, visit.resolution_m, visit.scale), gone.near(new, visit.resolution_m)
    for number in range(things.max(initial=-1) + 1):
        rows = things == number
        kind = ChangeKind.BACK if was_here[rows].mean() >= 0.5 else ChangeKind.APPEARED
        seen = _Points(new[rows], np.zeros(rows.sum(), np.int64), before_ns[rows])
        yield _change(kind, visit, seen)


def _change(kind: ChangeKind, visit: Visit, seen: _Points) -> DatedChange:
    low, high = seen.positions.min(axis=0), seen.positions.max(axis=0)
    centre, extent = (0.5 * (low + high)).tolist(), (high - low).tolist()
    thing = ChangedThing(
        kind, (centre[0], centre[1], centre[2]), (extent[0], extent[1], extent[2]), len(seen.positions)
    )
    return DatedChange(thing, visit.session, visit.stamp_ns, int(seen.stamps_ns.max()))


def _with_moves(vanished: list[DatedChange], appeared: list[DatedChange], scale: float) -> list[DatedChange]:
    """All changes of a visit; a thing that vanished near one of its size that appeared is one that moved."""
    pairs = sorted(
        (_apart_m(one.thing, other.thing), row, column)
        for row, one in enumerate(vanished)
        for column, other in enumerate(appeared)
        if _alike(one.thing, other.thing) and _apart_m(one.thing, other.thing) <= MOVED_M * scale
    )
    moved: dict[int, int] = {}
    for _, row, column in pairs:
        if row not in moved.values() and column not in moved:
            moved[column] = row
    changed = [
        _moved(other, vanished[moved[column]]) if column in moved else other for column, other in enumerate(appeared)
    ]
    return changed + [one for row, one in enumerate(vanished) if row not in moved.values()]


def _moved(appeared: DatedChange, vanished: DatedChange) -> DatedChange:
    thing = replace(appeared.thing, kind=ChangeKind.MOVED)
    return replace(appeared, thing=thing, before_ns=vanished.before_ns, moved_from_m=vanished.thing.centre_m)


def _apart_m(one: ChangedThing, other: ChangedThing) -> float:
    return float(np.linalg.norm(np.subtract(one.centre_m, other.centre_m)))


def _alike(one: ChangedThing, other: ChangedThing) -> bool:
    """Whether two boxes are of one size, whichever way they are turned."""
    edges = [np.array([*sorted(each.extent_m[:2]), each.extent_m[2]]) for each in (one, other)]
    return bool((np.abs(edges[0] - edges[1]) <= ALIKE * np.maximum(*edges)).all())
