"""Corrections by single loops, ahead of the optimisation that follows: a worker keeps its last map solved in memory.

Provisional: they rest on the version in force and on loops that were each held against its poses, and nothing else of
the map is moved by them. A version replaces them; so does every change that makes a part of the map's graph void.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import structlog

from revisit.core.geometry.se3 import Matrix4, pose_matrix, pose_row
from revisit.core.pose_graph.graph import GraphState
from revisit.service.domain.identity import TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import (
    EarlyCorrectionRecord,
    LoopRecord,
    MapRecord,
    SessionPosesRecord,
)
from revisit.service.domain.states import OperationKind, OperationState
from revisit.service.features.graph.anchor_verdicts import frames_on_earth
from revisit.service.features.graph.reading import MapTask, read_task, track_loop
from revisit.service.features.graph.session_poses import PackedSubmaps
from revisit.service.ports.clock import Clock
from revisit.service.ports.map_optimiser import (
    MapGraph,
    MapOptimiser,
    SessionTrack,
    SolvedMap,
    SolvedTrack,
    TrackLoop,
)
from revisit.service.ports.transactions import Transactions, UnitOfWork

log = structlog.get_logger(__name__)

LEAST_MOVE_M = 1e-3
"""A correction is told that moves the last submap of its session so far, metres."""

MOST_AT_ONCE = 2
"""Loops, at most, that are asked in one go: those of the best score. Many loops of a submap say much the same, and the
version that follows takes them all."""

SHARE = 0.2
"""Of a worker's time, at most, goes into corrections while other jobs of the tenant wait: after each it rests."""


@dataclass(frozen=True)
class _Later:
    """A submap, by number, and where the odometry of its session saw it."""

    number: int
    session_number: int
    T_odom_submap: Matrix4


@dataclass(frozen=True)
class _News:
    """The additions to a map since its version: loops that no version has seen, and submaps.

    `task` is there where the map has to be solved first; `loops` are the best of those up to `last_loop`, `submaps`
    those up to `last_submap`: each the last `seq`.
    """

    map: MapRecord
    task: MapTask | None
    loops: tuple[TrackLoop, ...]
    last_loop: int
    last_submap: int
    submaps: Sequence[_Later]


@dataclass
class _Held:
    """A map in this worker's memory: its version, the corrections of that, and the additions so far."""

    map: tuple[TenantId, str]
    key: tuple[int, int, int]
    solved: SolvedMap
    before: dict[int, SessionPosesRecord]
    in_version: frozenset[int]
    last_submap: int = 0
    last_loop: int = 0
    ends: dict[int, Matrix4] = field(default_factory=dict)
    asked: set[int] = field(default_factory=set)
    """The loops so far, by number: one that is accepted again is known."""

    @property
    def loops(self) -> int:
        """How many."""
        return len(self.asked)


class EarlyCorrections:
    """Keeps one map solved: that of the last loop."""

    def __init__(self, transactions: Transactions, clock: Clock, policy: Policy, optimiser: MapOptimiser) -> None:
        """`optimiser` solves the map."""
        self._transactions = transactions
        self._clock = clock
        self._policy = policy
        self._optimiser = optimiser
        self._held: _Held | None = None
        self._rest_until_ms = 0

    def release(self, tenant: TenantId, map_id: str) -> None:
        """Keep this map no longer: an optimisation begins that makes its solution void."""
        if self._held is not None and self._held.map == (tenant, map_id):
            self._held = None

    def update(self, tenant: TenantId, map_id: str) -> None:
        """Add the accepted loops of a map that its version has not seen, and store their corrections.

        For maps that are optimised by themselves. Errors are logged: the optimisation follows.
        """
        if not self._policy.optimise_after_loops:
            return
        began_ms = self._clock.monotonic_ms()
        try:
            self._update(tenant, map_id)
        except Exception:  # the job that found the loop has ended well
            log.exception("early_correction_failed", map=map_id)
            self._held = None
        ended_ms = self._clock.monotonic_ms()
        self._rest_until_ms = max(self._rest_until_ms, ended_ms + round((ended_ms - began_ms) * (1.0 / SHARE - 1.0)))

    def _update(self, tenant: TenantId, map_id: str) -> None:
        rests = self._clock.monotonic_ms() < self._rest_until_ms
        read = partial(_news, policy=self._policy, tenant=tenant, map_id=map_id, held=self._held, rests=rests)
        news = self._transactions.read(read).result()
        if news is None:
            return
        if news.task is not None:
            self._held = None  # its memory is needed for the next one
            self._held = self._solved(news.map, news.task)
        held = self._held
        if held is None or not _added(held, news):
            return
        rows = _rows(held, news.map, self._clock.wall_ns())
        self._transactions.write(partial(_store, known=news.map, rows=rows)).result()
        held.solved.refresh()

    def _solved(self, record: MapRecord, task: MapTask) -> _Held:
        before = {row.session_number: row for row in task.before}
        tracks = [_known_track(track, before[track.session_number])
                  for track in task.graph.tracks if track.session_number in before]  # fmt: skip
        seen = {loop.number for loop in task.loops if loop.graph_state == GraphState.IN_MAP.value}
        loops = tuple(loop for loop in task.graph.loops if loop.number in seen)
        graph = MapGraph(tuple(track for track, _ in tracks), loops, task.graph.window_m)
        in_version = frozenset(number for track in graph.tracks for number in track.submaps)
        solved = self._optimiser.solved(graph, [one for _, one in tracks])
        return _Held((record.tenant, record.map_id), _key(record), solved, before, in_version)


def _key(record: MapRecord) -> tuple[int, int, int]:
    return record.number, record.map_version, record.graph_edits


def _news(
    uow: UnitOfWork, policy: Policy, tenant: TenantId, map_id: str, held: _Held | None, *, rests: bool
) -> _News | None:
    """None where there is nothing to correct, or where other jobs wait and the worker `rests`."""
    record = uow.maps.get(tenant, map_id)
    if record is None or not record.map_version or _on_earth(uow, record):
        return None
    if rests and _others_wait(uow, tenant):
        return None
    if held is not None and held.key != _key(record):
        held = None
    after = 0 if held is None else held.last_loop
    accepted = uow.loops.accepted(tenant, map_id, after=after, graph_state=None)
    loops = tuple(track_loop(loop) for loop in _best(accepted))
    if not loops:
        return None
    last = accepted[-1].seq, uow.submaps.last_seq(tenant, map_id)
    if held is not None:
        placed = uow.submaps.placed(tenant, map_id, after=held.last_submap)
        later = [_Later(one.number, one.session_number, pose_matrix(one.T_odom_submap)) for one in placed]
        return _News(record, None, loops, *last, later)
    task = read_task(uow, policy, tenant, map_id)
    return None if task is None else _News(record, task, loops, *last, _submaps(task))


def _on_earth(uow: UnitOfWork, record: MapRecord) -> bool:
    """Whether anchors hold the version in force, which a solution by loops alone would let go."""
    version = uow.map_versions.get(record.tenant, record.map_id, record.map_version)
    return version is not None and bool(frames_on_earth(version.summary))


def _others_wait(uow: UnitOfWork, tenant: TenantId) -> bool:
    """Whether jobs wait; optimisations do not count: they wait for loops to settle."""
    queued, kind = OperationState.QUEUED.value, OperationKind.OPTIMISE_MAP.value
    return uow.jobs.count(tenant, state=queued) > uow.jobs.count(tenant, state=queued, kind=kind)


def _best(accepted: Sequence[LoopRecord]) -> list[LoopRecord]:
    known = [loop for loop in accepted if loop.T_match_query is not None]
    return sorted(known, key=lambda loop: (-loop.score, loop.number))[:MOST_AT_ONCE]


def _submaps(task: MapTask) -> list[_Later]:
    return [
        _Later(number, track.session_number, T_odom_submap)
        for track in task.graph.tracks
        for number, T_odom_submap in zip(track.submaps, track.T_odom_submap, strict=True)
    ]


def _known_track(track: SessionTrack, row: SessionPosesRecord) -> tuple[SessionTrack, SolvedTrack]:
    """The submaps of a track that the version has, and where it puts them."""
    packed = PackedSubmaps.of(row.submaps)
    place = {number: n for n, number in enumerate(packed.numbers.tolist())}
    there = [n for n, number in enumerate(track.submaps) if number in place]
    numbers = tuple(track.submaps[n] for n in there)
    poses = packed.T_map_submap[[place[number] for number in numbers]]
    anchor = int(row.frame.rpartition("-")[2])
    known = replace(track, submaps=numbers, T_odom_submap=track.T_odom_submap[there])
    return known, SolvedTrack(track.session_number, anchor, np.asarray(poses, dtype=np.float64))


def _added(held: _Held, news: _News) -> bool:
    """Whether any of the new loops moves the map."""
    for one in news.submaps:
        held.ends[one.session_number] = one.T_odom_submap
        if one.number not in held.in_version:
            held.solved.append(one.session_number, one.number, one.T_odom_submap)
    held.last_loop, held.last_submap = news.last_loop, news.last_submap
    moved = [held.solved.add(loop) for loop in news.loops if loop.number not in held.asked]
    held.asked.update(loop.number for loop in news.loops)
    return any(moved)


def _rows(held: _Held, record: MapRecord, now_ns: int) -> list[EarlyCorrectionRecord]:
    """The corrections that differ from those of the version."""
    rows = []
    for number, T_map_odom in held.solved.corrections().items():
        row, T_odom_last = held.before[number], held.ends[number]
        moved = T_map_odom @ T_odom_last - pose_matrix(row.T_map_odom) @ T_odom_last
        if np.linalg.norm(moved[:3, 3]) >= LEAST_MOVE_M:
            rows.append(
                EarlyCorrectionRecord(
                    tenant=record.tenant,
                    map_id=record.map_id,
                    session_id=row.session_id,
                    version=record.map_version,
                    loops=held.loops,
                    T_map_odom=pose_row(T_map_odom),
                    created_at_ns=now_ns,
                )
            )
    return rows


def _store(uow: UnitOfWork, known: MapRecord, rows: list[EarlyCorrectionRecord]) -> None:
    """Replace corrections that rest on fewer loops, unless the map has changed since it was read."""
    current = uow.maps.get(known.tenant, known.map_id, hold=True)
    if current is None or _key(current) != _key(known):
        return
    for row in rows:
        earlier = uow.early_corrections.get(row.tenant, row.map_id, row.session_id)
        if earlier is not None and earlier.version == row.version and earlier.loops > row.loops:
            continue
        if earlier is not None:
            uow.early_corrections.delete(row.tenant, number=earlier.number)
        uow.early_corrections.add(row)
