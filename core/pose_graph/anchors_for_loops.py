"""Loops that anchors decide: of the poses that fit a pair of submaps equally, one lies where anchors put the two.

Where a place repeats, geometry cannot tell by how many periods a pose is off; anchors whose errors are smaller than a
period can (docs/decisions/0362). They choose among poses that geometry found, and add none.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.pose_graph.anchored_drive import OWN_ERROR_M, Fix, anchored_drives
from revisit.core.pose_graph.anchors import Anchor
from revisit.core.pose_graph.graph import Node

Array64 = NDArray[np.float64]

SIGMAS = 3.0
"""So many standard deviations of both places a pose may lie off; one that does not is not chosen, and others that could
be must lie twice as far away.
"""

SURE_M = 1.5
"""Anchors must be as sure of heights, because storeys and decks are as like as rows are; and of the place on the ground
where a pair has one pose alone, doubted by others. Places that repeat lie farther apart.
"""

SAME_TURN_RAD = np.radians(15.0)
"""Poses that repeat are turned by a quarter, or not at all."""

LEAST_AGREEING, LEAST_FITTING, MOST_AGAINST = 3, 1 / 3, 0.2
"""Anchors of two drives are trusted where a pose fits for so many submaps, and for such a share of the pairs that they
put side by side: anchors that are wrong together find one by chance alone. And where they contradict no more than such
a share of the accepted loops, and such a share of the pairs with a pose nearby has it between half and twice as far off
as it may lie: poses that repeat are the true one or a period off, and by wrong anchors as often in between.
"""

NEAR_M = 10.0
"""Submaps that anchors put so near to each other see the same, so that the true pose should be among those that fit."""


@dataclass(frozen=True)
class OpenPair:
    """A pair of submaps, and the poses T_match_query (4, 4) that fit it, of which at most one is true; of an `accepted`
    loop its own. chosen: it is a loop because anchors chose the first of its poses, which proves nothing of theirs.
    """

    name: str
    match: Node
    query: Node
    poses: tuple[se3.Matrix4, ...]
    accepted: bool = False
    chosen: bool = False

    @property
    def drives(self) -> frozenset[str]:
        """The sessions of its submaps."""
        return frozenset((self.match.session, self.query.session))


class AnchorsForLoops:
    """The drives of a map with their anchors, asked for pairs between them."""

    def __init__(self, T_odom_submap: Mapping[str, Array64], anchors: Sequence[Anchor]) -> None:
        """T_odom_submap (n, 4, 4): the drive of each session. Drives whose anchors contradict them are left out."""
        drives = anchored_drives(T_odom_submap, anchors)
        self._drives = {name: drive for name, drive in drives.items() if drive.fits}
        self._fixes: dict[Node, Fix | None] = {}

    def apart_m(self, match: Node, query: Node) -> float | None:
        """How far apart anchors put two submaps, metres; None where they do not say."""
        between = self._between(match, query)
        return None if between is None else float(np.hypot(*between.place))

    def chosen(self, pairs: Iterable[OpenPair]) -> dict[str, int]:
        """The row of the pose that anchors choose, by name of the pairs for which they do; of none that is accepted.

        They choose between two drives alone whose anchors are trusted together: see LEAST_AGREEING. A chosen pose stays
        so while it lies where they put it.
        """
        asked = [(pair, between) for pair in pairs if (between := self._between(pair.match, pair.query)) is not None]
        telling: dict[frozenset[str], list[_Told]] = {}
        for pair, between in asked:
            if pair.accepted or np.hypot(*between.place) <= NEAR_M:
                telling.setdefault(pair.drives, []).append(_Told.of(pair, between))
        trusted = {drives for drives, found in telling.items() if _agree(found)}
        rows = {
            pair.name: between.kept(pair.poses) if pair.chosen else between.only(pair.poses)
            for pair, between in asked
            if pair.drives in trusted and not pair.accepted
        }
        return {name: row for name, row in rows.items() if row is not None}

    def _between(self, match: Node, query: Node) -> _Between | None:
        first, second = self._fix(match), self._fix(query)
        return None if first is None or second is None else _Between.of(first, second)

    def _fix(self, node: Node) -> Fix | None:
        if node not in self._fixes:
            drive = self._drives.get(node.session)
            self._fixes[node] = None if drive is None else drive.fix(node.ordinal)
        return self._fixes[node]


@dataclass(frozen=True)
class _Between:
    """A query as anchors put it to a match: place (2,) on the ground and rise along the axes of the odometry of the
    match, and R_odom_query (3, 3) there, with R_odom_match (3, 3); and by how much a pose may differ.
    """

    place: Array64
    rise_m: float
    R_odom_match: Array64
    R_odom_query: Array64
    allowed_m: float
    allowed_rise_m: float
    allowed_rad: float

    @classmethod
    def of(cls, match: Fix, query: Fix) -> _Between:
        east, north = query.place - match.place
        ahead = complex(east, north) * np.exp(-1j * match.turn_rad)
        sigma_m = float(np.hypot(np.hypot(match.sigma_m, query.sigma_m), match.sigma_rad * abs(ahead)))
        return cls(
            np.array([ahead.real, ahead.imag]),
            query.height_m - match.height_m,
            match.R_odom_submap,
            se3.from_yaw(query.turn_rad - match.turn_rad)[:3, :3] @ query.R_odom_submap,
            OWN_ERROR_M + SIGMAS * sigma_m,
            OWN_ERROR_M + SIGMAS * float(np.hypot(match.sigma_up_m, query.sigma_up_m)),
            SAME_TURN_RAD + SIGMAS * float(np.hypot(match.sigma_rad, query.sigma_rad)),
        )

    def agreeing(self, poses: Sequence[se3.Matrix4]) -> list[int]:
        """The rows of the poses that lie there."""
        return [row for row, off in enumerate(self._offs(poses)) if off <= 1.0]

    def has_beside(self, poses: Sequence[se3.Matrix4]) -> bool:
        """Whether the nearest of the poses lies between half and twice as far off as it may."""
        return 0.5 < min(self._offs(poses), default=np.inf) <= 2.0

    def kept(self, poses: Sequence[se3.Matrix4]) -> int | None:
        """The first row, where its pose lies there."""
        return 0 if 0 in self.agreeing(poses) else None

    def only(self, poses: Sequence[se3.Matrix4]) -> int | None:
        """The row of the one pose that lies there, where no two could: these all lie farther apart than anchors err."""
        rows = self.agreeing(poses)
        if len(rows) != 1 or self.allowed_rise_m > SURE_M:
            return None
        tells_apart = self.allowed_m <= SURE_M if len(poses) == 1 else self._tells_apart(poses)
        return rows[0] if tells_apart else None

    def _offs(self, poses: Sequence[se3.Matrix4]) -> list[float]:
        """How far off each pose lies, as a share of what it may."""
        return [self._off(pose) for pose in poses]

    def _off(self, pose: se3.Matrix4) -> float:
        ahead = self.R_odom_match @ pose[:3, 3]
        return max(
            float(np.hypot(*(ahead[:2] - self.place))) / self.allowed_m,
            abs(float(ahead[2]) - self.rise_m) / self.allowed_rise_m,
            _turned(self.R_odom_match @ pose[:3, :3] @ self.R_odom_query.T) / self.allowed_rad,
        )

    def _tells_apart(self, poses: Sequence[se3.Matrix4]) -> bool:
        leveled = [(self.R_odom_match @ pose[:3, 3], self.R_odom_match @ pose[:3, :3]) for pose in poses]
        return all(
            np.hypot(*(one[:2] - other[:2])) > 2.0 * self.allowed_m
            or _turned(R_one @ R_other.T) > 2.0 * self.allowed_rad
            for (one, R_one), (other, R_other) in combinations(leveled, 2)
        )


@dataclass(frozen=True)
class _Told:
    """A pair, and whether one of its poses lies where anchors put it, and whether the nearest lies a little beside."""

    pair: OpenPair
    fits: bool
    beside: bool

    @classmethod
    def of(cls, pair: OpenPair, between: _Between) -> _Told:
        return cls(pair, bool(between.agreeing(pair.poses)), between.has_beside(pair.poses))


def _agree(found: Sequence[_Told]) -> bool:
    """Whether a pose fits for enough submaps of two drives, hardly any lies beside, and hardly any accepted loop is
    contradicted.
    """
    fits = [one for one in found if one.fits]
    accepted = [one for one in found if one.pair.accepted]
    beside, nearby = sum(one.beside for one in found), sum(one.beside or one.fits for one in found)
    enough = len({one.pair.query for one in fits}) >= LEAST_AGREEING and len(fits) >= LEAST_FITTING * len(found)
    apart = beside <= MOST_AGAINST * nearby
    return enough and apart and sum(not one.fits for one in accepted) <= MOST_AGAINST * len(accepted)


def _turned(R: Array64) -> float:
    """The angle by which a rotation (3, 3) turns about the vertical axis, radians."""
    return abs(float(np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])))
