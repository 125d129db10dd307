"""Optimising a map: the worker's part, and the way into the queue."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

from revisit.service.domain.identity import TenantId
from revisit.service.domain.states import LoopState
from revisit.service.failpoints import failpoint
from revisit.service.features.corrections.job import EarlyCorrections
from revisit.service.features.graph.join_audit import JoinAudit
from revisit.service.features.graph.reading import MapTask, read_task
from revisit.service.features.operations.progress import OperationCancelled, Progress
from revisit.service.features.operations.unchanged import unchanged
from revisit.service.features.optimisation.rows import MAP_DELETED, VersionCommit
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.job_queue import CANCELLED, Lease
from revisit.service.ports.map_merger import MapMerger
from revisit.service.ports.map_optimiser import MapOptimiser, OptimisedMap, TrackAnchor
from revisit.service.ports.recogniser import PlaceKeeper

NO_SUBMAPS = {"outcome": "the map holds no submaps"}
"""The result of a job that had nothing to optimise."""

LOOPS_A_DELAY = 500
"""For every so many accepted loops of a map new ones settle for one more delay before it is optimised by itself: the
larger a map, the longer it takes (docs/decisions/0090)."""

LARGE_MAP_LOOPS = 2000
"""Accepted loops from which on optimising a map takes so much memory, and so long, that room is made for it."""

_READINGS = 5
"""How often a graph is read again that has lost a part while it was optimised."""


class MapOptimisation:
    """Runs the jobs that optimise maps; all calls block."""

    def __init__(
        self,
        context: JobContext,
        optimiser: MapOptimiser,
        merger: MapMerger,
        places: PlaceKeeper,
        early: EarlyCorrections,
    ) -> None:
        """`optimiser` places the sessions to each other, `merger` compares their surfaces; `places` and `early` hold
        memory that a large map needs.
        """
        self._context = context
        self._audit = JoinAudit(context, optimiser, merger)
        self._places = places
        self._early = early

    def run(self, lease: Lease) -> None:
        """Read the graph, optimise it, commit a version; the loops that came in meanwhile correct that version.

        Raises Unavailable where the graph changes all the time.
        """
        tenant, map_id = lease.job.tenant, str(lease.job.payload["map_id"])
        self.make_room(tenant, map_id)
        try:
            progress = Progress(self._context.transactions, self._context.clock, lease)
            message = "the map was changed again and again while it was optimised"
            unchanged(partial(self._ended, lease, progress), message, _READINGS)
        except OperationCancelled:
            self._context.complete(lease, CANCELLED)
        self._early.update(tenant, map_id)

    def make_room(self, tenant: TenantId, map_id: str) -> None:
        """Give memory back for the solution of a map."""
        self._early.release(tenant, map_id)
        accepted = {"map_id": map_id, "state": LoopState.ACCEPTED.value}
        if self._context.transactions.read(lambda uow: uow.loops.count(tenant, **accepted)).result() >= LARGE_MAP_LOOPS:
            self._places.release()

    def solved_each(
        self, task: MapTask, anchors: Iterable[tuple[TrackAnchor, ...]], progress: Progress
    ) -> list[OptimisedMap]:
        """The solution of a map by each of several sets of anchors instead of its own. Raises as `progress` does."""
        return self._audit.solved_each(task, anchors, progress)

    def _ended(self, lease: Lease, progress: Progress) -> bool:
        """One reading of the graph: whether the job has ended by it."""
        map_id = str(lease.job.payload["map_id"])
        read = partial(read_task, policy=self._context.policy, tenant=lease.job.tenant, map_id=map_id)
        progress("READ_MAP")
        task = self._context.transactions.read(read).result()
        if task is None or not task.graph.tracks:
            self._context.complete(lease, MAP_DELETED if task is None else NO_SUBMAPS)
            return True
        failpoint("optimise.after_read")
        optimised = self._audit.solved(task, progress)
        failpoint("optimise.after_solution")
        progress("COMMIT")
        commit = VersionCommit(lease, task, optimised, self._context.policy, self._context.clock.wall_ns())
        return self._context.transactions.write(commit).result()
