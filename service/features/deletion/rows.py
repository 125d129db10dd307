"""Deleting: a submap in one transaction; a session or a map is marked in one row, and nobody sees it any more.

The rows of marked resources go in portions (see `erasure`) and release their blobs with them. A crash in between leaves
hidden rows, which the next start goes on to delete.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from revisit.service.domain.records import DeletionRecord, MapRecord, SessionRecord, SubmapRecord
from revisit.service.domain.states import OperationState, SubmapState
from revisit.service.features.deletion.blob_references import blobs_of_submap, forget_made
from revisit.service.features.graph.anchors import move_origin
from revisit.service.features.graph.edits import note_edit
from revisit.service.features.graph.session_poses import forget_submap
from revisit.service.ports.transactions import UnitOfWork

SUBMAP_DELETED = {"outcome": "the submap was deleted"}
"""The result of a job for a deleted submap."""


def delete_submap(uow: UnitOfWork, record: MapRecord, submap: SubmapRecord, at_ns: int) -> None:
    """Delete a submap of a map with its loop closures."""
    forget_made(uow, submap.tenant, submap.map_id, submap.session_id)
    for rows in (uow.loops, uow.loop_events):
        rows.delete(submap.tenant, query_number=submap.number)
        rows.delete(submap.tenant, match_number=submap.number)
    forget_submap(uow, submap.tenant, submap.map_id, submap.session_id, submap.number)
    note_edit(uow, submap.tenant, submap.map_id)
    if submap.state == SubmapState.DESCRIBED:
        uow.changes.record_removed(record, [submap.number])
    drop_jobs(uow, [submap], at_ns)
    uow.submaps.delete(submap.tenant, number=submap.number)
    uow.blobs.release(submap.tenant, blobs_of_submap(submap))


def mark_session(uow: UnitOfWork, record: MapRecord, session: SessionRecord, at_ns: int) -> None:
    """Nobody sees a session of a map any more, with its scans, its submaps and their loop closures."""
    tenant, map_id, session_id = session.tenant, session.map_id, session.session_id
    forget_made(uow, tenant, map_id, session_id)
    uow.changes.record_session_removed(record, session.number)
    note_edit(uow, tenant, map_id)
    uow.deletions.add(DeletionRecord(tenant, map_id, session_id, at_ns))
    move_origin(uow, tenant, map_id)


def mark_map(uow: UnitOfWork, record: MapRecord, at_ns: int) -> None:
    """Nobody sees a map any more, with everything in it. Its index is for the caller to drop."""
    uow.deletions.add(DeletionRecord(record.tenant, record.map_id, "", at_ns))


def drop_jobs(uow: UnitOfWork, submaps: Sequence[SubmapRecord], at_ns: int) -> None:
    """End the jobs that wait to describe submaps; one that runs notices by itself."""
    done = OperationState.DONE.value
    for submap in submaps:
        queued = submap.state == SubmapState.QUEUED
        job = uow.jobs.get(submap.tenant, submap.operation_id, hold=True) if queued else None
        if job is not None and job.state == OperationState.QUEUED:
            uow.jobs.replace(replace(job, state=done, result=SUBMAP_DELETED, finished_at_ns=at_ns))
