"""Loops that anchors decide: of the poses that fit a pair of submaps equally, one lies where anchors put the two.

Where a place repeats, geometry cannot tell by how many periods a pose is off; anchors whose errors are smaller than a
period can (docs/decisions/0362). They choose among poses that geometry found, and add none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.pose_graph.anchored_drive import Fix, anchored_drives
from revisit.core.pose_graph.anchors import Anchor
from revisit.core.pose_graph.between import Between
from revisit.core.pose_graph.graph import Node
from revisit.core.pose_graph.tags import TagSighting
from revisit.core.pose_graph.tags_between import PutByTags, TagsBetween

Array64 = NDArray[np.float64]

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
    """The drives of a map with their anchors, and the tags that they saw, asked for pairs between them."""

    def __init__(
        self,
        T_odom_submap: Mapping[str, Array64],
        anchors: Sequence[Anchor],
        sightings: Sequence[TagSighting] = (),
    ) -> None:
        """T_odom_submap (n, 4, 4): the drive of each session. Drives whose anchors contradict them are left out."""
        drives = anchored_drives(T_odom_submap, anchors)
        self._drives = {name: drive for name, drive in drives.items() if drive.fits}
        self._fixes: dict[Node, Fix | None] = {}
        self._tags = TagsBetween(T_odom_submap, sightings)
        self._put: dict[tuple[Node, Node], PutByTags | None] = {}

    def apart_m(self, match: Node, query: Node) -> float | None:
        """How near to each other anchors or tags put two submaps, metres; None where they do not say."""
        told = [
            between for between in (self._by_fixes(match, query), self._by_tags(match, query)) if between is not None
        ]
        return min((float(np.hypot(*between.place)) for between in told), default=None)

    def chosen(self, pairs: Iterable[OpenPair]) -> dict[str, int]:
        """The row of the pose that anchors choose, by name of the pairs for which they do; of none that is accepted.

        They choose between two drives alone whose anchors are trusted together: see LEAST_AGREEING. A chosen pose stays
        so while it lies where they put it. Between drives where places and tags choose different ones, none is.
        """
        some = list(pairs)
        by_fixes, by_tags = (_chosen(some, put) for put in (self._by_fixes, self._by_tags))
        drives = {pair.name: pair.drives for pair in some}
        split = {drives[name] for name in by_fixes.keys() & by_tags if by_fixes[name] != by_tags[name]}
        return {name: row for name, row in (by_fixes | by_tags).items() if drives[name] not in split}

    def tags(self, pair: OpenPair, row: int) -> tuple[str, ...]:
        """The tags that agree on the pose in a row of a pair."""
        put = self._tagged(pair.match, pair.query)
        return () if put is None or row not in put.between.agreeing(pair.poses) else put.tags

    def _by_fixes(self, match: Node, query: Node) -> Between | None:
        first, second = self._fix(match), self._fix(query)
        return None if first is None or second is None else Between.of(first, second)

    def _fix(self, node: Node) -> Fix | None:
        if node not in self._fixes:
            drive = self._drives.get(node.session)
            self._fixes[node] = None if drive is None else drive.fix(node.ordinal)
        return self._fixes[node]

    def _by_tags(self, match: Node, query: Node) -> Between | None:
        put = self._tagged(match, query)
        return None if put is None else put.between

    def _tagged(self, match: Node, query: Node) -> PutByTags | None:
        if (match, query) not in self._put:
            self._put[match, query] = self._tags.put(match, query)
        return self._put[match, query]


def _chosen(pairs: Iterable[OpenPair], put: Callable[[Node, Node], Between | None]) -> dict[str, int]:
    """The row of the pose that one witness chooses, by name of pairs; `put` says where it has a query by a match."""
    asked = [(pair, between) for pair in pairs if (between := put(pair.match, pair.query)) is not None]
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


@dataclass(frozen=True)
class _Told:
    """A pair, and whether one of its poses lies where anchors put it, and whether the nearest lies a little beside."""

    pair: OpenPair
    fits: bool
    beside: bool

    @classmethod
    def of(cls, pair: OpenPair, between: Between) -> _Told:
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
