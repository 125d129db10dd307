"""The rules of retention: which submaps of a place are the best, and which scans no submap holds any more."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.service.domain.records import ScanRecord, SessionRecord
from revisit.service.domain.retention import HOUR_NS, KeptScans, RetentionPolicy
from revisit.service.domain.states import SessionState, SubmapState
from revisit.service.ports.repositories import SubmapStanding

LESS = {KeptScans.ALL: (), KeptScans.DESCRIBED: (KeptScans.ALL,), KeptScans.NONE: (KeptScans.ALL, KeptScans.DESCRIBED)}
"""The submaps that a policy has work with, by what they keep."""


@dataclass(frozen=True)
class RankedSubmap:
    """A described submap in a frame of its map, and what decides whether it is one of the best of its place.

    `mean_score`: of its accepted loops, so how well others saw there what it saw; 0 without one.
    """

    number: int
    frame: str
    storey: str | None
    position_m: tuple[float, float, float]
    flagged: bool
    mean_score: float
    point_count: int

    @property
    def rank(self) -> tuple[bool, float, int, int]:
        """The better, the smaller: without flags, then by score of its loops, then by points, then the newest."""
        return self.flagged, -self.mean_score, -self.point_count, -self.number


def retired(submaps: Iterable[RankedSubmap], best: int, within_m: float) -> list[int]:
    """The numbers of the submaps that have `best` better ones, which stay, less than `within_m` metres away.

    Distances are those of one frame and storey. A place that was seen keeps a view within that distance.
    """
    gone, kept = [], defaultdict[Any, list[tuple[float, float, float]]](list)
    for one in sorted(submaps, key=lambda submap: submap.rank):
        cell = np.floor(np.array(one.position_m) / within_m).astype(int)
        around = (tuple(cell + step) for step in product((-1, 0, 1), repeat=3))
        near = [place for key in around for place in kept[one.frame, one.storey, key]]
        if _nearer(near, one.position_m, within_m) >= best:
            gone.append(one.number)
        else:
            kept[one.frame, one.storey, tuple(cell)].append(one.position_m)
    return sorted(gone)


def _nearer(places: list[tuple[float, float, float]], position_m: tuple[float, float, float], within_m: float) -> int:
    if not places:
        return 0
    return int((np.linalg.norm(np.array(places) - position_m, axis=1) < within_m).sum())


@dataclass(frozen=True)
class PlacedView:
    """A submap with a neural map in a frame of its map; `time` orders those of one place (`merge.evidence.in_time`)."""

    number: int
    frame: str
    storey: str | None
    position_m: tuple[float, float, float]
    time: tuple[int, int, int]


def last_views(views: Iterable[PlacedView], edge_m: float) -> set[int]:
    """The numbers of the submaps that show their place last: the newest of each square of `edge_m` metres.

    Squares are those of one frame and storey, seen from above.
    """
    last = dict[Any, PlacedView]()
    for one in views:
        place = (one.frame, one.storey, *np.floor(np.array(one.position_m[:2]) / edge_m).astype(int).tolist())
        known = last.get(place)
        if known is None or known.time < one.time:
            last[place] = one
    return {one.number for one in last.values()}


def due_for_release(
    standings: Iterable[SubmapStanding], policy: RetentionPolicy, now_ns: int, held: Collection[int]
) -> list[int]:
    """The numbers of the submaps whose scans the policy keeps no longer, but for those `held`."""
    before_ns, less = now_ns - int(policy.scans_after_hours * HOUR_NS), LESS[policy.keep_scans]
    return [
        one.number
        for one in standings
        if one.kept_scans in less
        and one.number not in held
        and _described_at(one) <= before_ns
        # A posted cloud is what its description was made of.
        and (policy.keep_scans is KeptScans.NONE or one.first_seq is not None)
    ]


def _described_at(one: SubmapStanding) -> float:
    """When a submap was described, nanoseconds since 1970; never, for one that waits or has failed."""
    if one.state not in (SubmapState.DESCRIBED, SubmapState.RETIRED):
        return float("inf")
    return one.created_at_ns if one.described_at_ns is None else one.described_at_ns


@dataclass(frozen=True)
class HeldScans:
    """The scans of a session that must stay: of the ranges `whole`, the chosen ones of `chosen`, all from `open_from`,
    where `newest` is the last one of a session that has ended.

    Ranges (n, 2) of sequence numbers, both ends included, ascending and apart.
    """

    whole: NDArray[np.int64]
    chosen: NDArray[np.int64]
    open_from: int
    newest: int | None

    @classmethod
    def of(cls, session: SessionRecord, standings: Sequence[SubmapStanding], released: Collection[int]) -> HeldScans:
        """What the submaps of a session hold but for those `released`, and the window that is not full yet.

        The newest scan of a session says when it was last heard of: its row stays, also of a finished one.
        """
        active = session.state == SessionState.ACTIVE
        held = [one for one in standings if one.number not in released]
        return cls(
            _joined(one for one in held if one.kept_scans == KeptScans.ALL),
            _joined(one for one in held if one.kept_scans == KeptScans.DESCRIBED),
            min(session.window_first_seq, session.committed_seq) if active else session.committed_seq,
            None if active else session.committed_seq,
        )

    def frees(self, scan: ScanRecord) -> bool:
        """Whether nothing holds a scan."""
        return scan.seq < self.open_from and not self._holds(scan)

    def frees_cloud(self, scan: ScanRecord) -> bool:
        """Whether nothing holds the cloud of a scan, of which the row may have to stay."""
        return (
            bool(scan.cloud_sha256) and (scan.seq < self.open_from or scan.seq == self.newest) and not self._holds(scan)
        )

    def _holds(self, scan: ScanRecord) -> bool:
        return _within(self.whole, scan.seq) or (scan.chosen and _within(self.chosen, scan.seq))


def _joined(standings: Iterable[SubmapStanding]) -> NDArray[np.int64]:
    joined: list[list[int]] = []
    for first, last in sorted((one.first_seq, one.last_seq) for one in standings if one.first_seq and one.last_seq):
        if joined and first <= joined[-1][1] + 1:
            joined[-1][1] = max(joined[-1][1], last)
        else:
            joined.append([first, last])
    return np.array(joined, dtype=np.int64).reshape(-1, 2)


def _within(ranges: NDArray[np.int64], seq: int) -> bool:
    row = int(np.searchsorted(ranges[:, 0], seq, side="right")) - 1
    return row >= 0 and seq <= ranges[row, 1]
