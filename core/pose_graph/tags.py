"""Fiducials of unknown place: tags that a drive saw, where its odometry has them, and which of them count.

Nobody has surveyed a tag. Two passes that see the same one are at the same place; but ids are misread, tags are moved
between drives, and one id hangs at two places (docs/decisions/0369).
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry.path import travelled_m
from revisit.core.pose_graph.anchors import AnchorReason, AnchorState, JudgedAnchor
from revisit.core.pose_graph.graph import Node

Array64 = NDArray[np.float64]

_P = TypeVar("_P")

PASS_M = 30.0
"""Sightings of a tag along so much of a drive, at one spot, are one pass: they err together."""

SPOT_M, SPOT_SHARE, SIGMAS = 0.3, 0.02, 3.0
"""Sightings lie at one spot where they are so far apart at most, and by such a share of the way between them, and by so
many standard deviations.
"""

MISREAD_M, MISREAD_RATIO = 0.3, 3
"""A tag is misread where another one was seen at its spot, as near as this, so many times as often on the same pass; or
where the drive saw its id elsewhere as much more often.
"""

TWO_PLACES_M, TWO_PLACES_SHARE = 2.0, 0.05
"""A drive that sees a tag so far from where it saw it before, farther than it drifts, sees another one of its id."""

DOUBLED_SHARE = 0.1
"""A tag hangs at two places where such a share of the drives that saw it have seen it so: of a hundred drives a few
misread any id.
"""

SAME_PLACE_M = 1.0
"""Passes have a tag at one place of the map where they have it so near to each other, and by their deviations."""

MOST_OPEN, MOST_HELD = 16, 300
"""Spots at which a drive sees one tag along PASS_M, at most; and passes against which one is held: a tag at a dock is
passed thousands of times, and nothing bounds the spots of a false one.
"""


@dataclass(frozen=True)
class TagSighting:
    """The place point_submap (3,) of the tag of an id, as submap `node` saw it; sigma_m, of each axis."""

    name: str
    node: Node
    tag: str
    point_submap: Array64
    sigma_m: float


@dataclass(frozen=True)
class TagPass:
    """Sightings, by row, of one tag on one pass: the mean of their points (3,) in the odometry frame; where along the
    drive, metres, and where the first and the last were; sigma_m of one of them, or what they differ by where that is
    more.
    """

    tag: str
    rows: tuple[int, ...]
    along_m: float
    first_m: float
    last_m: float
    point_odom: Array64
    sigma_m: float


class TaggedDrive:
    """A drive with the tags that it saw. T_odom_submap (n, 4, 4), along_m (n,): its submaps; sightings unordered."""

    def __init__(self, T_odom_submap: Array64, sightings: Sequence[TagSighting]) -> None:
        """`sightings` are all of this drive."""
        self.T_odom_submap = T_odom_submap
        self.along_m = travelled_m(T_odom_submap[:, :3, 3])
        self.sightings = tuple(sightings)
        ordinals = np.array([one.node.ordinal for one in sightings], dtype=np.int64)
        points = np.array([one.point_submap for one in sightings])
        T = T_odom_submap[ordinals]
        self.points_odom = np.einsum("nij,nj->ni", T[:, :3, :3], points) + T[:, :3, 3]
        self._along_m = self.along_m[ordinals]

    @cached_property
    def passes(self) -> tuple[TagPass, ...]:
        """The passes that count, in the order of the drive: without misread ones."""
        return tuple(one for one, misread in zip(self._all, self._misread, strict=True) if not misread)

    @cached_property
    def misread(self) -> frozenset[int]:
        """The sightings, by row, whose id is another one's."""
        return frozenset(
            row for one, misread in zip(self._all, self._misread, strict=True) if misread for row in one.rows
        )

    @cached_property
    def doubled(self) -> frozenset[str]:
        """The tags that hang at two places of this drive."""
        return frozenset(tag for tag, its in _by_tag(self.passes).items() if _hangs_twice(its))

    def beside(self, along_m: float, reach_m: float) -> list[TagPass]:
        """The passes within reach of a place of the drive, the nearest first."""
        first = bisect_right(self.passes, along_m - reach_m, key=lambda one: one.along_m)
        last = bisect_left(self.passes, along_m + reach_m, key=lambda one: one.along_m)
        return sorted(self.passes[first:last], key=lambda one: abs(one.along_m - along_m))

    @cached_property
    def _all(self) -> tuple[TagPass, ...]:
        groups: list[list[int]] = []
        latest: dict[str, list[list[int]]] = {}
        for row in np.argsort(self._along_m, kind="stable").tolist():
            tag = self.sightings[row].tag
            its = [one for one in latest.get(tag, []) if self._along_m[row] - self._along_m[one[-1]] <= PASS_M]
            own = next((group for group in its if self._is_of_pass(row, group)), None)
            if own is None:
                own = []
                its.append(own)
                groups.append(own)
            own.append(row)
            latest[tag] = its[-MOST_OPEN:]
        return tuple(sorted(map(self._pass, groups), key=lambda one: (one.along_m, one.tag)))

    def _is_of_pass(self, row: int, group: Sequence[int]) -> bool:
        way_m = self._along_m[row] - self._along_m[group[-1]]
        off_m = np.linalg.norm(self.points_odom[row] - self.points_odom[group[0]])
        return bool(
            way_m <= PASS_M and off_m <= SPOT_M + SPOT_SHARE * way_m + SIGMAS * 2.0 * self.sightings[row].sigma_m
        )

    def _pass(self, rows: Sequence[int]) -> TagPass:
        points = self.points_odom[list(rows)]
        middle = points.mean(axis=0)
        spread_m = np.sqrt(((points - middle) ** 2).sum(axis=1).mean() / 3.0)
        stated_m = np.median([self.sightings[row].sigma_m for row in rows])
        return TagPass(
            self.sightings[rows[0]].tag,
            tuple(rows),
            float(self._along_m[list(rows)].mean()),
            float(self._along_m[rows[0]]),
            float(self._along_m[rows[-1]]),
            middle,
            float(max(spread_m, stated_m)),
        )

    @cached_property
    def _misread(self) -> list[bool]:
        """Whether each pass read a false id: the drive saw it elsewhere, or another tag there, far more often."""
        everyone = _Passes.of(self._all)
        of_tag = {tag: _Passes.of(_some(its)) for tag, its in _by_tag(self._all).items()}
        found = []
        for n, one in enumerate(self._all):
            first = bisect_left(self._all, one.along_m - PASS_M, key=lambda its: its.along_m)
            last = bisect_right(self._all, one.along_m + PASS_M, key=lambda its: its.along_m)
            near = everyone.part(slice(max(first, n - MOST_HELD), min(last, n + MOST_HELD)))
            its = of_tag[one.tag]
            elsewhere = its.outnumber(one) & its.are_two(one)
            found.append(bool(elsewhere.any() or (near.outnumber(one) & near.are_there(one)).any()))
        return found


def _by_tag(passes: Iterable[TagPass]) -> dict[str, list[TagPass]]:
    found: dict[str, list[TagPass]] = {}
    for one in passes:
        found.setdefault(one.tag, []).append(one)
    return found


def _some(passes: Sequence[_P]) -> Sequence[_P]:
    """MOST_HELD of passes, evenly along their order; all where they are fewer."""
    return passes[:: 1 + (len(passes) - 1) // MOST_HELD]


def _hangs_twice(passes: Sequence[TagPass]) -> bool:
    """Whether some of the passes of one tag by a drive saw another tag than the others."""
    held = _Passes.of(_some(passes))
    return any(bool(held.are_two(one).any()) for one in passes)


@dataclass(frozen=True)
class _Passes:
    """Passes of a drive as arrays (k,); their points (k, 3)."""

    tags: NDArray[np.object_]
    sightings: NDArray[np.int64]
    along_m: Array64
    points_odom: Array64
    sigmas_m: Array64

    @classmethod
    def of(cls, passes: Sequence[TagPass]) -> _Passes:
        return cls(
            np.array([one.tag for one in passes], dtype=object),
            np.array([len(one.rows) for one in passes], dtype=np.int64),
            np.array([one.along_m for one in passes]),
            np.array([one.point_odom for one in passes]),
            np.array([one.sigma_m for one in passes]),
        )

    def part(self, rows: slice) -> _Passes:
        return _Passes(
            self.tags[rows], self.sightings[rows], self.along_m[rows], self.points_odom[rows], self.sigmas_m[rows]
        )

    def outnumber(self, one: TagPass) -> NDArray[np.bool_]:
        """Which of them have so many more sightings than a pass."""
        return np.asarray(self.sightings >= MISREAD_RATIO * len(one.rows))

    def are_there(self, one: TagPass) -> NDArray[np.bool_]:
        """Which of them saw the spot of a pass, under another id."""
        within_m = MISREAD_M + SIGMAS * np.hypot(self.sigmas_m, one.sigma_m)
        return np.asarray((self.tags != one.tag) & (self._off_m(one) <= within_m))

    def are_two(self, one: TagPass) -> NDArray[np.bool_]:
        """Which of them saw another tag of the id of a pass, however the drive has drifted in between."""
        way_m = np.abs(self.along_m - one.along_m)
        may_m = TWO_PLACES_M + TWO_PLACES_SHARE * way_m + SIGMAS * (self.sigmas_m + one.sigma_m)
        return np.asarray((self.tags == one.tag) & (self._off_m(one) > may_m))

    def _off_m(self, one: TagPass) -> Array64:
        return np.asarray(np.linalg.norm(self.points_odom - one.point_odom, axis=1))


def tagged_drives(T_odom_submap: Mapping[str, Array64], sightings: Iterable[TagSighting]) -> dict[str, TaggedDrive]:
    """The sessions that saw tags, by name. T_odom_submap (n, 4, 4): the drive of each session."""
    of_session: dict[str, list[TagSighting]] = {}
    for one in sightings:
        of_session.setdefault(one.node.session, []).append(one)
    return {name: TaggedDrive(T_odom_submap[name], its) for name, its in of_session.items()}


def doubled_tags(drives: Collection[TaggedDrive]) -> frozenset[str]:
    """The tags that hang at two places, as drives have seen: they tell nothing of any."""
    saw = Counter(tag for one in drives for tag in {its.tag for its in one.passes})
    doubled = Counter(tag for one in drives for tag in one.doubled)
    return frozenset(tag for tag, times in doubled.items() if times >= DOUBLED_SHARE * saw[tag])


@dataclass(frozen=True)
class _Seen:
    """A pass in a frame of the map, at place (3,) of it."""

    drive: str
    its: TagPass
    frame: int
    place: Array64


def judged_sightings(
    T_odom_submap: Mapping[str, Array64],
    T_map_submap: Mapping[str, Array64],
    components: Sequence[Collection[str]],
    sightings: Sequence[TagSighting],
) -> list[JudgedAnchor]:
    """The verdict on each sighting, in their order, by where the map has its tag: T_map_submap (n, 4, 4) of each
    session in the frame of its component.

    IN_MAP: another pass has the tag there, too. A tag that no two passes have at one place has been moved, or read for
    another.
    """
    drives = tagged_drives(T_odom_submap, sightings)
    doubled = doubled_tags(drives.values())
    frame_of = {name: n for n, group in enumerate(components) for name in group}
    found: dict[str, JudgedAnchor] = {}
    seen: dict[str, list[_Seen]] = {}
    for name, drive in drives.items():
        found |= {drive.sightings[row].name: _verdict(AnchorReason.MISREAD) for row in drive.misread}
        for one in drive.passes:
            place = _place_map(drive, one, T_map_submap[name])
            seen.setdefault(one.tag, []).append(_Seen(name, one, frame_of[name], place))
    for tag, passes in seen.items():
        for own, verdict in zip(passes, _of_tag(passes, tag in doubled), strict=True):
            found |= {drives[own.drive].sightings[row].name: verdict for row in own.its.rows}
    return [found[one.name] for one in sightings]


def _place_map(drive: TaggedDrive, one: TagPass, T_map_submap: Array64) -> Array64:
    """The place (3,) of a tag in the frame of the map: as each of its submaps saw it."""
    ordinals = [drive.sightings[row].node.ordinal for row in one.rows]
    points = np.array([drive.sightings[row].point_submap for row in one.rows])
    T = T_map_submap[ordinals]
    return np.asarray((np.einsum("nij,nj->ni", T[:, :3, :3], points) + T[:, :3, 3]).mean(axis=0))


def _of_tag(passes: Sequence[_Seen], doubled: bool) -> list[JudgedAnchor]:
    """The verdicts on all passes of a tag."""
    frames = np.array([one.frame for one in passes])
    found: dict[int, JudgedAnchor] = {}
    for frame in np.unique(frames):
        rows = np.flatnonzero(frames == frame).tolist()
        found |= zip(rows, _of_frame([passes[row] for row in rows], doubled), strict=True)
    if len(passes) > 1:
        alone = [row for row, one in found.items() if one.reason is AnchorReason.SEEN_ONCE]
        found |= {row: _verdict(AnchorReason.NOT_JOINED) for row in alone}
    return [found[row] for row in range(len(passes))]


def _of_frame(passes: Sequence[_Seen], doubled: bool) -> list[JudgedAnchor]:
    """The verdicts on the passes of a tag in one frame, each held against the others."""
    if len(passes) == 1:
        return [_verdict(AnchorReason.SEEN_ONCE)]
    places, sigmas = np.array([one.place for one in passes]), np.array([one.its.sigma_m for one in passes])
    held = np.asarray(_some(range(len(passes))))
    beside = [_beside(places, sigmas, row, held) for row in range(len(passes))]
    others = [len(held) - (row in held) for row in range(len(passes))]
    shares = [len(its) / of for its, of in zip(beside, others, strict=True)]
    least = min(0.5, max(shares))
    verdicts = []
    for row, its in enumerate(beside):
        residual_m = np.median(places[its if len(its) else held[held != row]], axis=0) - places[row]
        squared = float(residual_m @ residual_m / (sigmas[row] ** 2 + (SAME_PLACE_M / SIGMAS) ** 2))
        if not doubled and len(its) and shares[row] >= least:
            verdicts.append(JudgedAnchor(AnchorState.IN_MAP, None, residual_m, squared))
        else:
            reason = AnchorReason.TWO_PLACES if doubled else AnchorReason.MOVED
            verdicts.append(_verdict(reason, residual_m, squared))
    return verdicts


def _beside(places: Array64, sigmas: Array64, row: int, held: NDArray[np.int64]) -> NDArray[np.int64]:
    """Those of the rows `held` but one, whose passes have the tag where that one has it."""
    may_m = SAME_PLACE_M + SIGMAS * np.hypot(sigmas[held], sigmas[row])
    return np.asarray(held[(np.linalg.norm(places[held] - places[row], axis=1) <= may_m) & (held != row)])


_NO_EFFECT = frozenset({AnchorReason.SEEN_ONCE, AnchorReason.NOT_JOINED})


def _verdict(reason: AnchorReason, residual_m: Array64 | None = None, squared_distance: float = np.nan) -> JudgedAnchor:
    state = AnchorState.NOT_ALIGNED if reason in _NO_EFFECT else AnchorState.SET_ASIDE
    return JudgedAnchor(state, reason, np.full(3, np.nan) if residual_m is None else residual_m, squared_distance)
