"""What anchors would do to a map, by a worker: it is solved without and with them, and nothing is kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from revisit.core.pose_graph.anchors import JudgedAnchor
from revisit.service.domain.identity import TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import AnchorRecord
from revisit.service.features.anchors.rules import AnchorQuestion
from revisit.service.features.graph.anchors import stored_frames
from revisit.service.features.graph.reading import MapTask, read_task
from revisit.service.features.operations.progress import OperationCancelled, Progress
from revisit.service.features.optimisation.job import NO_SUBMAPS, MapOptimisation
from revisit.service.features.optimisation.rows import MAP_DELETED
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.job_queue import CANCELLED, Lease
from revisit.service.ports.map_optimiser import GEOREFERENCES, OptimisedMap, TrackAnchor
from revisit.service.ports.transactions import UnitOfWork

OTHERS = 100
"""Anchors of the map, whose state would change, that a report names."""


@dataclass(frozen=True)
class _Asked:
    """The map with the anchors in question: these as stored, or with a number below 0."""

    task: MapTask
    anchors: tuple[AnchorRecord, ...]

    @property
    def without(self) -> tuple[TrackAnchor, ...]:
        """The anchors of the map as it is."""
        return tuple(one for one in self.task.graph.fixed if one.number > 0)


class AnchorPreview:
    """Runs the jobs that ask what anchors would do; all calls block."""

    def __init__(self, context: JobContext, optimisation: MapOptimisation) -> None:
        """`optimisation` makes versions."""
        self._context = context
        self._optimisation = optimisation

    def run(self, lease: Lease) -> None:
        """Solve the map without and with the anchors, and tell the difference."""
        progress = Progress(self._context.transactions, self._context.clock, lease)
        try:
            self._context.complete(lease, self._told(lease, progress))
        except OperationCancelled:
            self._context.complete(lease, CANCELLED)

    def _told(self, lease: Lease, progress: Progress) -> dict[str, Any]:
        tenant, question = lease.job.tenant, AnchorQuestion.of(lease.job.payload)
        progress("READ_MAP")
        read = partial(_read, policy=self._context.policy, tenant=tenant, question=question)
        asked = self._context.transactions.read(read).result()
        if asked is None or not asked.task.graph.tracks:
            return MAP_DELETED if asked is None else NO_SUBMAPS
        self._optimisation.make_room(tenant, question.map_id)
        fixed = asked.without, asked.task.graph.fixed
        before, after = self._optimisation.solved_each(asked.task, fixed, progress)
        changed = _changed(asked, before, after)
        named = self._context.transactions.read(lambda uow: uow.anchors.numbered(tenant, changed[:OTHERS])).result()
        return {
            "anchors": _verdicts(asked.anchors, after),
            "others": _verdicts([*named.values()], after),
            GEOREFERENCES: stored_frames(after.on_earth, asked.task.session_names),
            **_moves_m(before, after),
        }


def _read(uow: UnitOfWork, policy: Policy, tenant: TenantId, question: AnchorQuestion) -> _Asked | None:
    anchors = []
    for place, one in enumerate(question.anchors, 1):
        known = uow.anchors.get(tenant, one.map_id, one.session_id, one.anchor_id)
        anchors.append(replace(one, number=-place) if known is None else known)
    more = [one for one in anchors if one.number < 0]
    task = read_task(uow, policy, tenant, question.map_id, more)
    return None if task is None else _Asked(task, tuple(anchors))


def _changed(asked: _Asked, before: OptimisedMap, after: OptimisedMap) -> list[int]:
    """The anchors of the map that are none of those in question, and whose state would change, by number."""
    own, known = {one.number for one in asked.anchors}, _by_number(before)
    return [
        number
        for number, verdict in _by_number(after).items()
        if number not in own and number in known and known[number].state != verdict.state
    ]


def _by_number(optimised: OptimisedMap) -> dict[int, JudgedAnchor]:
    return {one.number: one.verdict for one in optimised.anchors}


def _verdicts(rows: Sequence[AnchorRecord], optimised: OptimisedMap) -> list[dict[str, Any]]:
    """Name, state, reason and residual of anchors; the name alone where the session has no submap yet."""
    known = _by_number(optimised)
    return [{"name": one.name, **(_told(known[one.number]) if one.number in known else {})} for one in rows]


def _told(verdict: JudgedAnchor) -> dict[str, Any]:
    found = bool(np.isfinite(verdict.residual_m).all())
    return {
        "state": verdict.state.value,
        "reason": "" if verdict.reason is None else verdict.reason.value,
        **({"residual_m": verdict.residual_m.tolist()} if found else {}),
    }


def _moves_m(before: OptimisedMap, after: OptimisedMap) -> dict[str, float]:
    """How far submaps would move in their frames, metres."""
    moved = np.concatenate(
        [
            np.linalg.norm(one.T_map_submap[:, :3, 3] - other.T_map_submap[:, :3, 3], axis=1)
            for one, other in zip(before.tracks, after.tracks, strict=True)
            if one.anchor == other.anchor
        ]
        or [np.empty(0)]
    )
    return {"mean_change_m": float(moved.mean()), "max_change_m": float(moved.max())} if len(moved) else {}
