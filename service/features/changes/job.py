"""Looking for what changed between the drives of a version, by a worker: square by square, a portion in each job."""

from __future__ import annotations

from functools import partial
from typing import Any

from revisit.service.capacity.backlog import queued_job
from revisit.service.domain.errors import NotFound
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import JobRecord, MapTileRecord
from revisit.service.domain.states import OperationKind
from revisit.service.failpoints import failpoint
from revisit.service.features.changes.rows import (
    STORED_ID,
    FoundChanges,
    MapChange,
    compared_squares,
    stored_changes,
)
from revisit.service.features.graph.told_changes import find_changes_soon, tell_changes, untold_drives
from revisit.service.features.operations.progress import OperationCancelled, Progress
from revisit.service.features.operations.unchanged import unchanged
from revisit.service.features.tiles.rows import Tiling, planned, read_tiling
from revisit.service.ports.blobs import NEURAL_MAP_BLOB, TILE_BLOB
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.job_queue import CANCELLED, Lease
from revisit.service.ports.map_tiles import TileKey, TileMaker
from revisit.service.ports.storage import require_map
from revisit.service.ports.transactions import UnitOfWork

PORTION_MS = 30_000
"""A job looks for so long, then leaves the rest to the next one: other jobs go between."""


class ChangeFinding:
    """Runs the jobs that find changes; all calls block."""

    def __init__(self, context: JobContext, maker: TileMaker) -> None:
        """`maker` is the method."""
        self._context = context
        self._maker = maker

    def run(self, lease: Lease) -> None:
        """Compare the next squares of a version and store what was found. Raises NotFound, Unavailable."""
        progress = Progress(self._context.transactions, self._context.clock, lease)
        try:
            message = "the submaps of the map were changed again and again while they were compared"
            unchanged(partial(self._portion, lease, progress), message)
        except OperationCancelled:
            self._context.complete(lease, CANCELLED)
        except NotFound as error:
            if not self._context.transactions.write(partial(self._moved_on, lease=lease, error=error)).result():
                raise

    def _moved_on(self, uow: UnitOfWork, lease: Lease, error: NotFound) -> bool:
        """Fail the job of a version that left while it waited: drives of which nothing was told are compared in the
        one in force. False where the version is there.
        """
        tenant, map_id, version = lease.job.tenant, lease.job.payload["map_id"], lease.job.payload["version"]
        if uow.map_versions.get(tenant, map_id, version) is not None:
            return False
        uow.queue.fail(lease, error.code, error.message, retry=False)
        find_changes_soon(uow, tenant, map_id, self._context.policy, self._context.clock.wall_ns())
        return True

    def _portion(self, lease: Lease, progress: Progress) -> bool:
        """Whether the job has ended by a portion; not where submaps have changed meanwhile."""
        tenant, payload = lease.job.tenant, lease.job.payload
        read = partial(self._read, tenant=tenant, payload=payload)
        tiling, squares, before = self._context.transactions.read(read).result()
        found = FoundChanges(0, len(squares), ())
        if before is not None:
            found = FoundChanges.of(self._context.blobs.get(tenant, TILE_BLOB, before))
        end_ms = self._context.clock.monotonic_ms() + PORTION_MS
        for key in squares[found.compared :]:
            progress("COMPARE_SURFACES", found.compared, len(squares))
            found = found.with_square(self._changes(tenant, tiling, key))
            if self._context.clock.monotonic_ms() > end_ms:
                break
        put = partial(self._context.blobs.put, tenant, TILE_BLOB, found.to_blob())
        sha256 = put()
        failpoint("changes.after_blob")
        commit = partial(self._stored, lease=lease, tiling=tiling, before=before, sha256=sha256, found=found)
        return self._context.write_naming(commit, put)

    def _read(
        self, uow: UnitOfWork, tenant: TenantId, payload: dict[str, Any]
    ) -> tuple[Tiling, list[TileKey], str | None]:
        map_id, version = payload["map_id"], payload["version"]
        tiling = read_tiling(uow, self._context.policy, tenant, map_id, version)
        scale = self._context.policy.for_map(require_map(uow, tenant, map_id)).scene_scale
        return tiling, compared_squares(tiling, scale), stored_changes(uow, tenant, map_id, version)

    def _changes(self, tenant: TenantId, tiling: Tiling, key: TileKey) -> list[MapChange]:
        """What drives found changed in a square."""
        frame = tiling.frame(key.frame)
        rows = tiling.reaching(key)
        plan = partial(planned, tenant=tenant, frame=frame, rows=rows)
        placed = [one.placed() for one in self._context.transactions.read(plan).result()]
        read = partial(self._context.blobs.get, tenant, NEURAL_MAP_BLOB)
        found = self._maker.changes(placed, tiling.grid.centre(key.cell), read)
        return [MapChange.of(key.frame, one) for one in found]

    def _stored(
        self, uow: UnitOfWork, lease: Lease, tiling: Tiling, before: str | None, sha256: str, found: FoundChanges
    ) -> bool:
        """Store the row and end the job, in one transaction, if the submaps are the same; queue the next portion."""
        tenant, map_id, version = lease.job.tenant, tiling.map_id, tiling.version
        record = uow.maps.get(tenant, map_id, hold=True)
        untold = [] if record is None else untold_drives(uow, record, version)
        uow.queue.require(lease)
        try:
            now, _, known = self._read(uow, tenant, lease.job.payload)
        except NotFound:
            return False
        if known != before or not now.is_of(tiling):
            return False
        if sha256 != before:
            uow.map_tiles.delete(tenant, map_id=map_id, version=version, tile_id=STORED_ID)
            uow.blobs.refer(tenant, [(TILE_BLOB, sha256)])
            if before is not None:
                uow.blobs.release(tenant, {(TILE_BLOB, before)})
            submaps, now_ns = sum(len(one.numbers) for one in tiling.frames), self._context.clock.wall_ns()
            uow.map_tiles.add(MapTileRecord(tenant, map_id, version, STORED_ID, sha256, submaps, now_ns))
        uow.queue.complete(lease, {"compared": found.compared, "squares": found.squares, "changes": len(found.changes)})
        if found.complete:
            tell_changes(uow, untold, {one.number: found.of_drive(version, one.number) for one in untold})
        elif untold:
            uow.queue.enqueue(self._next_portion(lease))
        find_changes_soon(uow, tenant, map_id, self._context.policy, self._context.clock.wall_ns())
        return True

    def _next_portion(self, lease: Lease) -> JobRecord:
        """The job that goes on where nobody asks again."""
        job, now_ns = lease.job, self._context.clock.wall_ns()
        kind = OperationKind.FIND_CHANGES
        return queued_job(job.tenant, kind, job.subject, job.payload, self._context.policy, now_ns, job.priority)
