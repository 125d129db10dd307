"""Where tags of unknown place put one submap of a pair to the other.

The tags beside both submaps, each as its drive has it, lie in one way to each other: that of most of them. Two must
agree, so that one that was misread or moved says nothing (docs/decisions/0369).
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.pose_graph.anchored_drive import BESIDE_M, OWN_ERROR_M
from revisit.core.pose_graph.between import SAME_TURN_RAD, SIGMAS, Between
from revisit.core.pose_graph.graph import LoopEdge, Node
from revisit.core.pose_graph.tags import TaggedDrive, TagPass, TagSighting, doubled_tags, tagged_drives

Array64 = NDArray[np.float64]

LEAST_TAGS, LEAST_RATIO = 2, 2
"""Tags that agree, at least; so many times as many as those that do not, and as others that agree among themselves."""

LEAST_REFUTING, REFUTED_OFF, REFUTED_SPREAD_M = 3, 2.0, 5.0
"""So many tags that agree, and none that does not, refute a loop that lies so many times as far off as it may; a rack
that was moved carries its tags along, but they hang near each other.
"""

LEAST_APART_M = 3.0
"""Two tags tell a heading where they lie so far apart."""

MOST_TAGS, MOST_FITTED = 8, 4
"""So many passes nearest to a submap are asked; so many of those that agree tell where it lies: odometry bends little
on a short way.
"""

AGREE_M, DRIFT_SHARE, MOST_DRIFT_SHARE = 0.2, 0.005, 0.02
"""Tags agree where they lie so far apart at most, SIGMAS beside, and as odometry may drift on the way to them on both
drives: by such a share of it, standard deviation, and at most.
"""


@dataclass(frozen=True)
class _Common:
    """A tag that both passed: points (2,) on the ground and heights by their odometry; sigma_m of both together, with
    the drift on the ways to the two submaps, way_m together, and slack_m, the most that they may lie apart; whether it
    was seen before or at the match, at or after it, and so of the query.
    """

    tag: str
    match: complex
    query: complex
    rise_m: float
    sigma_m: float
    slack_m: float
    way_m: float
    sides: tuple[bool, bool, bool, bool]

    @classmethod
    def of(cls, match: TagPass, match_m: float, query: TagPass, query_m: float) -> _Common:
        """match_m and query_m: where the two submaps are along their drives, metres."""
        way_m = abs(match.along_m - match_m) + abs(query.along_m - query_m)
        both_m = float(np.hypot(match.sigma_m, query.sigma_m))
        return cls(
            match.tag,
            complex(*match.point_odom[:2]),
            complex(*query.point_odom[:2]),
            float(match.point_odom[2] - query.point_odom[2]),
            float(np.hypot(both_m, DRIFT_SHARE * way_m)),
            AGREE_M + SIGMAS * both_m + MOST_DRIFT_SHARE * way_m,
            way_m,
            (match.first_m <= match_m, match.last_m >= match_m, query.first_m <= query_m, query.last_m >= query_m),
        )


@dataclass(frozen=True)
class _Laid:
    """The odometry of the query in that of the match: turned by the angle of a complex number of length 1 about `about`
    there, which lies at `at` here, and rise; how far the tags that tell it lie from their middle, and how sure each is.
    """

    turned: complex
    about: complex
    at: complex
    rise_m: float
    spread_m: float
    sigma_m: float

    @classmethod
    def of(cls, some: Sequence[_Common]) -> _Laid:
        """As fits some tags best."""
        weights = np.array([one.sigma_m for one in some]) ** -2.0
        weights /= weights.sum()
        matches, queries = (np.array(points) for points in ([one.match for one in some], [one.query for one in some]))
        at, about = weights @ matches, weights @ queries
        turned = complex(np.vdot(queries - about, weights * (matches - at)))
        turned /= abs(turned)
        off_m = np.abs(matches - at - (queries - about) * turned)
        rises_m = np.array([one.rise_m for one in some])
        rise_m = float(weights @ rises_m)
        rms_m = float(np.sqrt(weights @ off_m**2 + weights @ (rises_m - rise_m) ** 2))
        spread_m = float(np.sqrt(weights @ np.abs(queries - about) ** 2))
        stated_m = float(np.median([one.sigma_m for one in some]))
        return cls(turned, complex(about), complex(at), rise_m, spread_m, float(np.hypot(stated_m, rms_m)))

    @classmethod
    def by_two(cls, one: _Common, other: _Common) -> _Laid | None:
        """As two tags lie; None where they are too near to each other, or farther apart on one drive than the other."""
        here, there = one.match - other.match, one.query - other.query
        slack_m = one.slack_m + other.slack_m
        if one.tag == other.tag or min(abs(here), abs(there)) < LEAST_APART_M or abs(abs(here) - abs(there)) > slack_m:
            return None
        if abs(one.rise_m - other.rise_m) > slack_m:
            return None
        share = other.sigma_m**2 / (one.sigma_m**2 + other.sigma_m**2)
        turned = here / there
        return cls(
            turned / abs(turned),
            other.query + share * there,
            other.match + share * here,
            other.rise_m + share * (one.rise_m - other.rise_m),
            abs(there) * math.sqrt(share * (1.0 - share)),
            math.sqrt(one.sigma_m * other.sigma_m),
        )

    def place(self, query: complex) -> complex:
        """A point of the query's odometry in that of the match."""
        return self.at + (query - self.about) * self.turned

    def agreeing(self, common: Sequence[_Common]) -> list[_Common]:
        """Of each tag the one that lies here nearest to where the other drive has it, of those that agree."""
        found: dict[str, tuple[float, _Common]] = {}
        for one in common:
            off_m = max(abs(self.place(one.query) - one.match), abs(self.rise_m - one.rise_m))
            if off_m <= one.slack_m and off_m < found.get(one.tag, (np.inf,))[0]:
                found[one.tag] = off_m, one
        return [one for _, one in found.values()]


@dataclass(frozen=True)
class PutByTags:
    """A query as tags put it to a match, and the tags that agree on it; `against`: how many do not."""

    between: Between
    tags: tuple[str, ...]
    against: int
    spread_m: float


class TagsBetween:
    """The drives of a map with the tags that they saw, asked for pairs between them."""

    def __init__(self, T_odom_submap: Mapping[str, Array64], sightings: Sequence[TagSighting]) -> None:
        """T_odom_submap (n, 4, 4): the drive of each session."""
        self._drives = tagged_drives(T_odom_submap, sightings)
        self._doubled = doubled_tags(self._drives.values())

    def put(self, match: Node, query: Node) -> PutByTags | None:
        """Where tags put the query; None where fewer than two agree, or not most of those that both passed, and where a
        drive saw those that agree on one side of its submap alone: odometry may have slipped on the way to them.
        """
        if match.session not in self._drives or query.session not in self._drives:
            return None
        first, second = self._drives[match.session], self._drives[query.session]
        common = self._common(first, match.ordinal, second, query.ordinal)
        laid = _laid(common)
        if laid is None:
            return None
        its = laid.agreeing(common)
        if not np.any([one.sides for one in its], axis=0).all():
            return None
        between = _between(laid, first.T_odom_submap[match.ordinal], second.T_odom_submap[query.ordinal])
        against = len({one.tag for one in common}) - len(its)
        return PutByTags(between, tuple(sorted(one.tag for one in its)), against, laid.spread_m)

    def _common(self, first: TaggedDrive, match: int, second: TaggedDrive, query: int) -> list[_Common]:
        """Of two passes of one drive each has its own half of the way between them."""
        reach_m = BESIDE_M
        if first is second:
            reach_m = min(reach_m, 0.5 * abs(first.along_m[match] - first.along_m[query]))
        here, there = self._beside(first, match, reach_m), self._beside(second, query, reach_m)
        return [
            _Common.of(one, first.along_m[match], other, second.along_m[query])
            for one in here
            for other in there
            if one.tag == other.tag
        ]

    def _beside(self, drive: TaggedDrive, ordinal: int, reach_m: float) -> list[TagPass]:
        """The nearest passes along the drive of tags that hang at one place alone."""
        near, doubled = drive.beside(float(drive.along_m[ordinal]), reach_m), self._doubled | drive.doubled
        return [one for one in near if one.tag not in doubled][:MOST_TAGS]


def refuted_by_tags(
    T_odom_submap: Mapping[str, Array64], loops: Iterable[LoopEdge], sightings: Sequence[TagSighting]
) -> set[str]:
    """The names of the loops that tags speak against: they put the two submaps elsewhere. T_odom_submap (n, 4, 4): the
    drive of each session.
    """
    asked = TagsBetween(T_odom_submap, sightings)
    return {loop.name for loop in loops if _is_refuted(loop, asked.put(loop.match, loop.query))}


def _is_refuted(loop: LoopEdge, put: PutByTags | None) -> bool:
    if put is None or put.against or len(put.tags) < LEAST_REFUTING or put.spread_m < REFUTED_SPREAD_M:
        return False
    return put.between.off(loop.T_match_query) > REFUTED_OFF


def _laid(common: Sequence[_Common]) -> _Laid | None:
    """The way in which most tags lie; None where two do not agree, or as many others speak against it."""
    best = _most(common)
    if len(best) < LEAST_TAGS:
        return None
    laid = _Laid.of(sorted(best, key=lambda one: (one.way_m, one.tag))[:MOST_FITTED])
    its = laid.agreeing(common)
    others = [one for one in common if one not in its]
    against = len({one.tag for one in common}) - len(its)
    if len(its) < max(LEAST_TAGS, LEAST_RATIO * against, LEAST_RATIO * len(_most(others))):
        return None
    return laid


def _most(common: Sequence[_Common]) -> list[_Common]:
    """The most tags that lie in one way; none where no two do."""
    found = (laid.agreeing(common) for pair in combinations(common, 2) if (laid := _Laid.by_two(*pair)) is not None)
    return max(found, key=len, default=[])


def _between(laid: _Laid, T_odom_match: Array64, T_odom_query: Array64) -> Between:
    way = complex(*T_odom_query[:2, 3]) - laid.about
    place = laid.place(complex(*T_odom_query[:2, 3])) - complex(*T_odom_match[:2, 3])
    turn_sigma = laid.sigma_m / laid.spread_m
    sigma_m = float(np.hypot(laid.sigma_m, turn_sigma * abs(way)))
    return Between(
        np.array([place.real, place.imag]),
        float(T_odom_query[2, 3] + laid.rise_m - T_odom_match[2, 3]),
        T_odom_match[:3, :3],
        se3.from_yaw(cmath.phase(laid.turned))[:3, :3] @ T_odom_query[:3, :3],
        OWN_ERROR_M + SIGMAS * sigma_m,
        OWN_ERROR_M + SIGMAS * laid.sigma_m,
        SAME_TURN_RAD + SIGMAS * turn_sigma,
    )
