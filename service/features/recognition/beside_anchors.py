"""Ambiguous loops of which anchors choose one pose, and loops that anchors chose and no longer do.

Where places repeat, anchors that are surer than a period tell which of the poses of a pair is true; its surfaces are
then registered from there (docs/decisions/0362).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial

from revisit.core.acceptance import Doubt
from revisit.core.geometry.se3 import Matrix4
from revisit.core.pose_graph.anchors_for_loops import OpenPair
from revisit.service.domain.identity import TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import LoopRecord
from revisit.service.features.graph.anchors import AnchoredSubmaps
from revisit.service.features.graph.doubted_loops import LOOPS_AT_ONCE
from revisit.service.features.graph.map_jobs import is_or_was_anchored
from revisit.service.features.graph.reading import MapTask, read_task
from revisit.service.features.loops.claims import is_by_anchors, poses_of
from revisit.service.ports.repositories import LoopEnds
from revisit.service.ports.transactions import Transactions, UnitOfWork

ASKED_M = 40.0
"""Pairs that anchors put farther apart share no surface."""

_REFUTED = frozenset({Doubt.ODOMETRY_INCONSISTENT, Doubt.RADIO_DISAGREES})
"""Doubts of other witnesses, which anchors do not overrule."""


@dataclass(frozen=True)
class ChosenLoop:
    """An ambiguous loop, by number, the pose T_match_query (4, 4) that anchors choose, those that they rule out, and
    the tags among them; none where places choose it.
    """

    number: int
    T_match_query: Matrix4
    ruled_out: tuple[Matrix4, ...]
    tags: tuple[str, ...]


@dataclass(frozen=True)
class ByAnchors:
    """Loops that anchors choose, of submaps with the fewest loops first; and the numbers of accepted ones that they
    chose before and do not choose now.
    """

    chosen: list[ChosenLoop] = field(default_factory=list)
    lost: list[int] = field(default_factory=list)


def loops_by_anchors(
    transactions: Transactions, policy: Policy, tenant: TenantId, map_id: str, is_tested: Callable[..., bool]
) -> ByAnchors:
    """The loops of a map as its anchors have them now; none where it never had any.

    `is_tested` (a loop, a pose): whether it was registered from about there before. Blocks; reads page by page.
    """
    task = transactions.read(partial(_task_with_anchors, policy=policy, tenant=tenant, map_id=map_id)).result()
    if task is None:
        return ByAnchors()
    submaps = AnchoredSubmaps.of(task.graph, task.graph.fixed)
    standing = list(_standing(transactions, tenant, task, submaps))
    ambiguous = list(_ambiguous(transactions, tenant, map_id, submaps, is_tested)) if task.graph.fixed else []
    rows = submaps.asked.chosen([*standing, *(one.pair for one in ambiguous)])
    found = [one for one in ambiguous if one.pair.name in rows and rows[one.pair.name] not in one.tested]
    lost = [int(pair.name) for pair in standing if pair.chosen and pair.name not in rows]
    turns = ((one, rows[one.pair.name]) for one in _in_turn(found, standing))
    return ByAnchors([one.chosen(row, submaps.asked.tags(one.pair, row)) for one, row in turns], lost)


@dataclass(frozen=True)
class _Ambiguous:
    """An ambiguous loop and its poses; `tested`: the rows of those from which it was registered before."""

    pair: OpenPair
    similarity: float
    tested: frozenset[int]

    def chosen(self, row: int, tags: tuple[str, ...]) -> ChosenLoop:
        """With the pose in a row, by these tags."""
        others = (*self.pair.poses[:row], *self.pair.poses[row + 1 :])
        return ChosenLoop(int(self.pair.name), self.pair.poses[row], others, tags)


def _in_turn(found: Iterable[_Ambiguous], standing: Iterable[OpenPair]) -> list[_Ambiguous]:
    """Each query in its turn, the most similar loop first: a version tests few, and a second of a query tells less."""
    loops, turns = Counter(pair.query for pair in standing), list[tuple[int, _Ambiguous]]()
    for one in sorted(found, key=lambda one: -one.similarity):
        turns.append((loops[one.pair.query], one))
        loops[one.pair.query] += 1
    return [one for _, one in sorted(turns, key=lambda turn: turn[0])]


def _task_with_anchors(uow: UnitOfWork, policy: Policy, tenant: TenantId, map_id: str) -> MapTask | None:
    """A map that has anchors, or had some."""
    return read_task(uow, policy, tenant, map_id) if is_or_was_anchored(uow, tenant, map_id) else None


def _ambiguous(
    transactions: Transactions, tenant: TenantId, map_id: str, submaps: AnchoredSubmaps, is_tested: Callable[..., bool]
) -> Iterator[_Ambiguous]:
    """The ambiguous loops of pairs that anchors do not put far from each other."""
    after: int | None = 0
    while after is not None:
        page = transactions.read(partial(_page, tenant=tenant, map_id=map_id, submaps=submaps, after=after)).result()
        ends, loops = page
        for loop in loops:
            pair = submaps.pair(loop.number, loop.match_number, loop.query_number, poses_of(loop))
            tested = frozenset(row for row, pose in enumerate(pair.poses) if is_tested(loop, pose))
            yield _Ambiguous(pair, loop.similarity, tested)
        after = ends[-1].number if len(ends) == LOOPS_AT_ONCE else None


def _page(
    uow: UnitOfWork, tenant: TenantId, map_id: str, submaps: AnchoredSubmaps, after: int
) -> tuple[list[LoopEnds], list[LoopRecord]]:
    """The ends of a page of ambiguous loops, and those that are asked about."""
    ends = uow.loops.rejected(tenant, map_id, ["AMBIGUOUS"], after=after, limit=LOOPS_AT_ONCE)
    near = [one.number for one in ends if submaps.is_within(one.match_number, one.query_number, ASKED_M)]
    loops = uow.loops.numbered(tenant, near).values()
    return ends, [one for one in loops if _is_open(one)]


def _is_open(loop: LoopRecord) -> bool:
    """Whether nothing but other poses, or other loops, speaks against a pair that passed."""
    return loop.T_match_query is not None and not _REFUTED & loop.evidence.get("doubts", {}).keys()


def _standing(
    transactions: Transactions, tenant: TenantId, task: MapTask, submaps: AnchoredSubmaps
) -> Iterator[OpenPair]:
    """The accepted loops of a map, and which of them anchors chose."""
    numbers = [one.number for one in task.graph.loops]
    for start in range(0, len(numbers), LOOPS_AT_ONCE):
        read = partial(_numbered, tenant=tenant, numbers=numbers[start : start + LOOPS_AT_ONCE])
        for loop in transactions.read(read).result():
            yield submaps.accepted(
                loop.number, loop.match_number, loop.query_number, poses_of(loop), is_by_anchors(loop)
            )


def _numbered(uow: UnitOfWork, tenant: TenantId, numbers: list[int]) -> list[LoopRecord]:
    return list(uow.loops.numbered(tenant, numbers).values())
