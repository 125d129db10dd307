"""Deleting: the rows of a submap, session or map in one transaction, then the blobs that no row names any more.

A crash in between leaves blobs, which the next sweep deletes, and never a part of the rows. The transaction holds up
all other writers, so rows are read and changed in sets, not one by one.
"""

from __future__ import annotations

from dataclasses import replace

from revisit.service.application.catalogue.blob_references import (
    Blob,
    blobs_of_rows,
    blobs_of_submap,
    forget_all_made,
    forget_made,
)
from revisit.service.application.contract.graph_edits import note_edit
from revisit.service.application.contract.identity import TenantId
from revisit.service.application.contract.records import MapRecord, SessionRecord, SubmapRecord
from revisit.service.application.contract.session_poses import forget_submap
from revisit.service.application.contract.states import OperationState, SubmapState
from revisit.service.application.contract.transactions import UnitOfWork

SUBMAP_DELETED = {"outcome": "the submap was deleted"}
"""The result of a job whose submap is gone."""


def delete_submap(uow: UnitOfWork, record: MapRecord, submap: SubmapRecord, at_ns: int) -> set[Blob]:
    """Delete a submap of a map with its loop closures; its blobs, which other rows may name too."""
    made = forget_made(uow, submap.tenant, submap.map_id, submap.session_id)
    for rows in (uow.loops, uow.loop_events):
        rows.delete(submap.tenant, query_number=submap.number)
        rows.delete(submap.tenant, match_number=submap.number)
    forget_submap(uow, submap.tenant, submap.map_id, submap.session_id, submap.number)
    note_edit(uow, submap.tenant, submap.map_id)
    _remove_from_index(uow, record, at_ns, number=submap.number)
    uow.submaps.delete(submap.tenant, number=submap.number)
    return blobs_of_submap(submap) | made


def delete_session(uow: UnitOfWork, record: MapRecord, session: SessionRecord, at_ns: int) -> set[Blob]:
    """Delete a session of a map with its scans, its submaps and their loop closures; their blobs."""
    tenant, of_session = session.tenant, {"map_id": session.map_id, "session_id": session.session_id}
    doomed = blobs_of_rows(uow, tenant, **of_session)
    doomed |= forget_made(uow, tenant, session.map_id, session.session_id)
    _remove_from_index(uow, record, at_ns, **of_session)
    for side in ("query_session_id", "match_session_id"):
        for rows in (uow.loops, uow.loop_events):
            rows.delete(tenant, map_id=session.map_id, **{side: session.session_id})
    for of_it in (uow.early_corrections, uow.session_poses, uow.submaps, uow.scans, uow.sessions):
        of_it.delete(tenant, **of_session)
    note_edit(uow, tenant, session.map_id)
    return doomed


def delete_map(uow: UnitOfWork, record: MapRecord, at_ns: int) -> set[Blob]:
    """Delete a map with everything in it; its blobs. Its index is for the caller to drop."""
    of_map = {"map_id": record.map_id}
    doomed = blobs_of_rows(uow, record.tenant, **of_map) | forget_all_made(uow, record.tenant, record.map_id)
    _drop_jobs(uow, record.tenant, at_ns, **of_map)
    versions = (uow.map_merges, uow.early_corrections, uow.session_poses, uow.map_versions)
    for rows in (*versions, uow.loop_events, uow.loops, uow.submaps, uow.scans, uow.sessions, uow.maps):
        rows.delete(record.tenant, **of_map)
    return doomed


def _remove_from_index(uow: UnitOfWork, record: MapRecord, at_ns: int, **submaps: str | int) -> None:
    """Take submaps of a map out of the index or, where they are not there yet, out of the queue."""
    described = uow.submaps.distinct(record.tenant, "number", state=SubmapState.DESCRIBED.value, **submaps)
    uow.changes.record_removed(record.tenant, record.number, described)
    _drop_jobs(uow, record.tenant, at_ns, **submaps)


def _drop_jobs(uow: UnitOfWork, tenant: TenantId, at_ns: int, **submaps: str | int) -> None:
    """End the jobs that wait to describe submaps; one that runs notices by itself."""
    done = OperationState.DONE.value
    for operation_id in uow.submaps.distinct(tenant, "operation_id", state=SubmapState.QUEUED.value, **submaps):
        job = uow.jobs.get(tenant, operation_id)
        if job is not None and job.state == OperationState.QUEUED:
            uow.jobs.replace(replace(job, state=done, result=SUBMAP_DELETED, finished_at_ns=at_ns))
