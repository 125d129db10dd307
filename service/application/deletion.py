"""Deleting: the rows of a submap, session or map in one transaction, then the blobs that no row names any more.

A crash in between leaves blobs that the next sweep finds; it never leaves a part of the rows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TypeVar

from service.application.blob_references import Blob, blobs_of_submap
from service.application.clouds import CLOUD_BLOB
from service.application.identity import TenantId
from service.application.operations import SUBMAP_DELETED, OperationState
from service.application.ports import Repository, UnitOfWork
from service.application.records import MapRecord, ScanRecord, SessionRecord, SubmapRecord

Row = TypeVar("Row", ScanRecord, SubmapRecord)

PORTION = 1000
"""Rows that are read at a time: a map may have more of them than fit into the memory."""


def delete_submap(uow: UnitOfWork, record: MapRecord, submap: SubmapRecord, at_ns: int) -> set[Blob]:
    """Delete a submap of a map with its loop closures; its blobs, which other rows may name too."""
    uow.loops.delete(submap.tenant, query_number=submap.number)
    uow.loops.delete(submap.tenant, match_number=submap.number)
    _forget(uow, record, submap, at_ns)
    uow.submaps.delete(submap.tenant, number=submap.number)
    return blobs_of_submap(submap)


def delete_session(uow: UnitOfWork, record: MapRecord, session: SessionRecord, at_ns: int) -> set[Blob]:
    """Delete a session of a map with its scans, its submaps and their loop closures; their blobs."""
    tenant, of_session = session.tenant, {"map_id": session.map_id, "session_id": session.session_id}
    doomed = _blobs_of_scans(uow, tenant, of_session)
    for submap in _every(uow.submaps, tenant, of_session):
        _forget(uow, record, submap, at_ns)
        doomed |= blobs_of_submap(submap)
    for side in ("query_session_id", "match_session_id"):
        uow.loops.delete(tenant, map_id=session.map_id, **{side: session.session_id})
    uow.submaps.delete(tenant, **of_session)
    uow.scans.delete(tenant, **of_session)
    uow.sessions.delete(tenant, **of_session)
    return doomed


def delete_map(uow: UnitOfWork, record: MapRecord, at_ns: int) -> set[Blob]:
    """Delete a map with everything in it; its blobs. Its index is for the caller to drop."""
    of_map = {"map_id": record.map_id}
    doomed = _blobs_of_scans(uow, record.tenant, of_map)
    for submap in _every(uow.submaps, record.tenant, of_map):
        if submap.descriptor is None:
            _drop_job(uow, submap, at_ns)
        doomed |= blobs_of_submap(submap)
    for rows in (uow.loops, uow.submaps, uow.scans, uow.sessions, uow.maps):
        rows.delete(record.tenant, **of_map)
    return doomed


def _forget(uow: UnitOfWork, record: MapRecord, submap: SubmapRecord, at_ns: int) -> None:
    """Take a submap out of the index or, where it is not there yet, out of the queue."""
    if submap.descriptor is not None:
        uow.changes.record_removed(submap.tenant, record.number, submap.number)
    else:
        _drop_job(uow, submap, at_ns)


def _drop_job(uow: UnitOfWork, submap: SubmapRecord, at_ns: int) -> None:
    """End the job that waits to describe a submap; one that runs notices by itself."""
    job = uow.jobs.get(submap.tenant, submap.operation_id)
    if job is not None and job.state == OperationState.QUEUED:
        done = OperationState.DONE.value
        uow.jobs.replace(replace(job, state=done, result=SUBMAP_DELETED, finished_at_ns=at_ns))


def _blobs_of_scans(uow: UnitOfWork, tenant: TenantId, equals: dict[str, str]) -> set[Blob]:
    return {(CLOUD_BLOB, scan.cloud_sha256) for scan in _every(uow.scans, tenant, equals)}


def _every(rows: Repository[Row], tenant: TenantId, equals: dict[str, str]) -> Iterator[Row]:
    after = 0
    while portion := rows.find(tenant, after=after, limit=PORTION, **equals):
        yield from portion
        after = portion[-1].number
