"""Sessions share a frame of a map only where their surfaces agree: the rule of merges, within one map."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial

from revisit.core.errors import DataLoss
from revisit.core.geometry.se3 import Matrix4
from revisit.core.merge.evidence import MergeEvidence, MergeRefusal, surfaces_refusal
from revisit.core.pose_graph.faults import MOST_SOLVED_TWICE, OdometryFault
from revisit.core.pose_graph.graph import GraphState
from revisit.service.domain.identity import TenantId
from revisit.service.features.graph.anchors import loops_against
from revisit.service.features.graph.doubted_loops import contradicted, doubted_loops, within_frames
from revisit.service.features.graph.fault_audit import Placed, decided
from revisit.service.features.graph.reading import MapTask
from revisit.service.features.graph.released_maps import released_maps
from revisit.service.features.graph.session_poses import PackedSubmaps
from revisit.service.ports.blobs import NEURAL_MAP_BLOB
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.map_merger import MapMerger, Surfaces
from revisit.service.ports.map_optimiser import (
    MapByLoops,
    MapOptimiser,
    OptimisedMap,
    Progress,
    RefusedJoin,
    TrackAnchor,
    TrackLoop,
)

DoubtedLoops = Callable[[], tuple[TrackLoop, ...]]

VERSION_PAIRS = 100
"""Pairs of submaps, about, whose surfaces are compared for a version: 0.03 to 0.17 s of a core each."""

MOST_PAIRS = 40
LEAST_PAIRS = 8
"""Pairs for one join: fewer where a version has many."""

FAULT_PAIRS = 20
"""Pairs for one side of an undecided fault of odometry, asked twice: with the fault mended, and without."""

GROWTH = 0.1
"""A session is compared again once it has more submaps, by this share, than when it was compared last."""

Sessions = frozenset[int]
"""Numbers of sessions."""

Refused = frozenset[tuple[int, str]]
"""Loops by number, each with the reason why it counts for nothing."""


@dataclass(frozen=True)
class _Joins:
    """Pairs of sessions that a solution joins by loops, those with most loops first, and which of them are settled."""

    pairs: tuple[Sessions, ...]
    settled: frozenset[Sessions]

    @classmethod
    def of(cls, task: MapTask, optimised: OptimisedMap) -> _Joins:
        """Of loops between two sessions."""
        kept = {loop.number for loop in optimised.loops if loop.state is GraphState.IN_MAP}
        found = Counter(pair for number, pair in _ends(task) if number in kept and len(pair) == 2)
        ordered = sorted(found, key=lambda pair: (-found[pair], sorted(pair)))
        return cls(tuple(ordered), frozenset(found.keys() & _settled(task)))


class JoinAudit:
    """Solves maps by loops and surfaces."""

    def __init__(self, context: JobContext, optimiser: MapOptimiser, merger: MapMerger) -> None:
        """`optimiser` places sessions by loops, `merger` compares surfaces."""
        self._context = context
        self._optimiser = optimiser
        self._merger = merger

    def solved(self, task: MapTask, progress: Progress) -> OptimisedMap:
        """The solution of a map without the loops of joins that surfaces speak against. Blocks.

        The graph is solved again after each refusal, which takes a loop of it or more. Raises as `progress` does.
        """
        return self.solved_each(task, (task.graph.fixed,), progress)[0]

    def solved_each(
        self, task: MapTask, anchors: Iterable[tuple[TrackAnchor, ...]], progress: Progress
    ) -> list[OptimisedMap]:
        """As `solved`, by each of several sets of anchors instead of the map's own: its loops are solved once."""
        tenant = TenantId(task.map.tenant)
        surfaces = self._merger.surfaces(partial(_neural_map, self._context, tenant))
        read = partial(released_maps, tenant=tenant, map_id=task.map.map_id)
        scale = self._context.policy.for_map(task.map).scene_scale
        released = self._context.transactions.read(read).result()
        asked = partial(_Audit, scale, self._merger, task, surfaces, released, doubted=self._doubted_once(task))
        by_loops: dict[Refused, MapByLoops] = {}
        return [self._solved(task, fixed, by_loops, asked(progress=progress), progress) for fixed in anchors]

    def _doubted_once(self, task: MapTask) -> DoubtedLoops:
        """The doubted loops of a map, read when they are first asked for."""
        read = partial(doubted_loops, tenant=TenantId(task.map.tenant), map_id=task.map.map_id)
        return cache(lambda: self._context.transactions.read(read).result())

    def _solved(
        self,
        task: MapTask,
        fixed: tuple[TrackAnchor, ...],
        by_loops: dict[Refused, MapByLoops],
        asked: _Audit,
        progress: Progress,
    ) -> OptimisedMap:
        """The solution by some anchors; `by_loops` keeps those without any, by the loops that are refused."""
        refused: tuple[RefusedJoin, ...] = ()
        undecided: tuple[OdometryFault, ...] = ()
        against = loops_against(task.graph, fixed)
        while True:
            loops = against | dict(loops_between(task, refused))
            key = frozenset(loops.items())
            if key not in by_loops:
                by_loops[key] = self._optimiser.by_loops(replace(task.graph, refused=loops), progress)
            found = by_loops[key].held(fixed)
            optimised = asked.decided(found)
            more = asked.refused(optimised)
            optimised, more = self._by_doubted(task, fixed, loops, optimised, more, asked, progress)
            before = (one for one in undecided if not any(one.is_beside(other) for other in found.faults))
            faults = (*optimised.faults, *before)
            if not more:
                audited = {**_audited(task), **optimised.audited}
                return replace(optimised, faults=faults, refused_joins=refused, audited=audited)
            refused += more
            undecided = tuple(one for one in faults if one.undecided)

    def _by_doubted(
        self, task: MapTask, fixed: tuple[TrackAnchor, ...], refused: Mapping[int, str], optimised: OptimisedMap,
        joins: tuple[RefusedJoin, ...], asked: _Audit, progress: Progress,
    ) -> tuple[OptimisedMap, tuple[RefusedJoin, ...]]:  # fmt: skip
        """A solution some of whose `joins` surfaces refuse, and these; or the one with faults of odometry that doubted
        loops show and surfaces decide, where they refuse nothing with it, and more loops hold: the next version
        compares them again, as those loops may not be accepted. An undecided fault lies where doubted loops show it:
        those beside it are among them. Where drives are kept apart the faults are told.
        """
        sessions, doubted = _doubted(task, optimised, joins, asked)
        if not doubted or not sessions:
            return optimised, joins
        graph = replace(task.graph, loops=(*task.graph.loops, *doubted), refused=refused)
        found = self._optimiser.by_loops(graph, progress).held(fixed)
        mended = found.otherwise or found
        known = tuple(one for one in optimised.faults if not one.undecided)
        broken = [one for one in found.faults if one.kind.is_at_once and not any(map(one.is_beside, known))]
        before = [one for one in optimised.faults if one.undecided and not any(map(one.is_beside, broken))]
        faults = (*known, *(replace(one, undecided=True) for one in broken))
        doubtful = replace(optimised, faults=faults, otherwise=mended if broken else None)
        other = asked.decided(doubtful, replace(task, graph=graph))
        is_decided = sum(not one.undecided for one in other.faults) > len(known)
        if is_decided and _in_map(other) > _in_map(optimised) and not asked.refused(other, sessions):
            asked_again = dict.fromkeys(sessions, 0)
            return replace(other, loops=other.loops[: len(task.graph.loops)], audited=asked_again), ()
        told = faults if is_decided else other.faults
        return replace(optimised, faults=(*told, *before)) if joins else optimised, joins

    def refused(self, task: MapTask, progress: Progress) -> tuple[RefusedJoin, ...]:
        """The joins that its solution is without; a map is not solved where the version in force has said it."""
        return self.solved(task, progress).refused_joins if _has_unsettled(task) else ()


class _Audit:
    """The audit of one map for one version; a join that it allowed it does not ask about again."""

    def __init__(
        self,
        scale: float,
        merger: MapMerger,
        task: MapTask,
        surfaces: Surfaces,
        released: frozenset[int],
        progress: Progress,
        doubted: DoubtedLoops = tuple,
    ) -> None:
        """`scale` is that of the scene; of the submaps that are `released` there is no neural map; `doubted` reads the
        loops that only others contradict.
        """
        self._merger = merger
        self._task = task
        self._progress = progress
        self._scale = scale
        self._allowed: set[frozenset[Sessions]] = set()
        self._surfaces = surfaces
        self._released = released
        self.doubted = doubted

    def refused(self, optimised: OptimisedMap, anew: Sessions = frozenset()) -> tuple[RefusedJoin, ...]:
        """The joins of a solution that the surfaces speak against; those with sessions `anew` are asked about again.

        Groups of sessions grow by the pair with most loops first; each join of two groups is asked over their whole
        overlap. What is refused stays so, whatever joins either side later.
        """
        joins = _Joins.of(self._task, optimised)
        groups = {track.session_number: frozenset((track.session_number,)) for track in optimised.tracks}
        for pair in joins.settled:
            if not pair & anew:
                _unite(groups, pair)
        most = self._pairs_each(len({*groups.values()}))
        refused: dict[Sessions, tuple[MergeRefusal, MergeEvidence]] = {}
        for pair in joins.pairs:
            sides = _sides(groups, pair)
            if len(sides) == 1 or any(_sides(groups, known) == sides for known in refused):
                continue
            known = sides in self._allowed and not any(side & anew for side in sides)
            found = None if known else self._compared(optimised, sides, most)
            reason = None if found is None else surfaces_refusal(found, self._merger.limits.scaled(self._scale))
            if found is None or reason is None:
                self._allowed.add(sides)
                _unite(groups, pair)
            else:
                refused[pair] = reason, found
        why = {_sides(groups, pair): refusal for pair, refusal in refused.items()}
        return tuple(_refused_join(self._task, sides, *refusal) for sides, refusal in why.items())

    def decided(self, optimised: OptimisedMap, task: MapTask | None = None) -> OptimisedMap:
        """A solution, of a `task` with doubted loops perhaps, with its undecided faults of odometry mended, or without
        them, where the surfaces decide.
        """

        def compared(first: Placed, second: Placed) -> MergeEvidence | None:
            return self._by_surfaces(first, second, FAULT_PAIRS)

        return decided(task or self._task, optimised, compared, self._merger.limits.scaled(self._scale))

    def _pairs_each(self, groups: int) -> int:
        return max(LEAST_PAIRS, min(MOST_PAIRS, VERSION_PAIRS // max(groups - 1, 1)))

    def _compared(self, optimised: OptimisedMap, sides: frozenset[Sessions], most: int) -> MergeEvidence | None:
        first, second = (_poses(self._task, optimised, side) for side in sorted(sides, key=min))
        return self._by_surfaces(first, second, most)

    def _by_surfaces(self, first: Placed, second: Placed, most: int) -> MergeEvidence | None:
        """The surfaces of two groups of submaps, of `most` pairs; None where a group has none to compare."""
        one, other = ({n: T for n, T in group.items() if n not in self._released} for group in (first, second))
        if not one or not other:
            return None
        return self._merger.audit(one, other, self._surfaces, self._scale, most, self._progress)


def _doubted(
    task: MapTask, optimised: OptimisedMap, joins: tuple[RefusedJoin, ...], asked: _Audit
) -> tuple[Sessions, tuple[TrackLoop, ...]]:
    """The sessions of refused `joins`, or those that doubted loops contradict in a solution, and doubted loops of
    sessions that it joins: what was refused before, these do not join again.
    """
    sessions = frozenset(number for join in joins for number in (*join.sessions, *join.others))
    if not joins and sum(len(one.submaps) for one in task.graph.tracks) > MOST_SOLVED_TWICE:
        return sessions, ()
    doubted = within_frames(task.graph, optimised, asked.doubted())
    return sessions or contradicted(task.graph, optimised, doubted), doubted


def _in_map(optimised: OptimisedMap) -> int:
    return sum(loop.state is GraphState.IN_MAP for loop in optimised.loops)


def _neural_map(context: JobContext, tenant: TenantId, number: int) -> bytes:
    """The neural map of a submap. Raises DataLoss where it has none, or is gone."""
    row = context.transactions.read(lambda uow: uow.submaps.numbered(tenant, [number])).result().get(number)
    if row is None or row.neural_map_sha256 is None:
        raise DataLoss(f"submap {number} has no neural map")
    return context.blobs.get(tenant, NEURAL_MAP_BLOB, row.neural_map_sha256)


def loops_between(task: MapTask, joins: Iterable[RefusedJoin]) -> Iterator[tuple[int, str]]:
    """The loops of the graph between the sides of refused joins, by number, each with the reason."""
    ends = list(_ends(task))
    for join in joins:
        for number, pair in ends:
            if pair.intersection(join.sessions) and pair.intersection(join.others):
                yield number, join.reason


def _refused_join(
    task: MapTask, sides: frozenset[Sessions], reason: MergeRefusal, evidence: MergeEvidence
) -> RefusedJoin:
    one, other = sorted(sides, key=min)
    join = RefusedJoin(tuple(sorted(one)), tuple(sorted(other)), reason, 0, evidence)
    return replace(join, loops=sum(1 for _ in loops_between(task, [join])))


def _ends(task: MapTask) -> Iterator[tuple[int, Sessions]]:
    """The loops of the graph by number, each with the sessions of its ends: one or two."""
    session = {number: track.session_number for track in task.graph.tracks for number in track.submaps}
    for loop in task.graph.loops:
        yield loop.number, frozenset((session[loop.match], session[loop.query]))


def _settled(task: MapTask) -> set[Sessions]:
    """The pairs of sessions with loops that share a frame of the version in force and have hardly grown."""
    frames, grown = {row.session_number: row.frame for row in task.before}, _grown(task)
    pairs = {pair for _, pair in _ends(task) if not pair & grown and pair <= frames.keys()}
    return {pair for pair in pairs if len({frames[number] for number in pair}) == 1}


def _grown(task: MapTask) -> Sessions:
    """The sessions that are new, or have more submaps by GROWTH than when their surfaces were compared."""
    known = _known_submaps(task)
    return frozenset(
        track.session_number
        for track in task.graph.tracks
        if len(track.submaps) > (1.0 + GROWTH) * known.get(track.session_number, 0)
    )


def _known_submaps(task: MapTask) -> dict[int, int]:
    """How many submaps each session had when its surfaces were compared, or in a version that does not say it."""
    return {row.session_number: len(PackedSubmaps.of(row.submaps).numbers) for row in task.before} | dict(task.audited)


def _audited(task: MapTask) -> dict[int, int]:
    """How many submaps each session has that is compared now, and had that is not."""
    known, grown = _known_submaps(task), _grown(task)
    return {
        track.session_number: len(track.submaps) if track.session_number in grown else known[track.session_number]
        for track in task.graph.tracks
    }


def _has_unsettled(task: MapTask) -> bool:
    return any(len(pair) == 2 for pair in {pair for _, pair in _ends(task)} - _settled(task))


def _poses(task: MapTask, optimised: OptimisedMap, sessions: Sessions) -> dict[int, Matrix4]:
    """T_map_submap (4, 4) of the submaps of some sessions, by number; without those that a broken step of odometry may
    lie before or behind: nobody knows where they are.
    """
    unknown = {
        (fault.session, ordinal)
        for fault in optimised.faults
        if fault.kind.is_at_once
        for ordinal in range(fault.first + 1, fault.last)
    }
    return {
        number: T_map_submap
        for track, solved in zip(task.graph.tracks, optimised.tracks, strict=True)
        if track.session_number in sessions
        for ordinal, (number, T_map_submap) in enumerate(zip(track.submaps, solved.T_map_submap, strict=True))
        if (str(track.session_number), ordinal) not in unknown
    }


def _sides(groups: dict[int, Sessions], pair: Sessions) -> frozenset[Sessions]:
    """The groups of two sessions, or the one of both."""
    return frozenset(groups[number] for number in pair)


def _unite(groups: dict[int, Sessions], pair: Sessions) -> None:
    united = frozenset[int]().union(*(groups[number] for number in pair))
    groups.update(dict.fromkeys(united, united))
