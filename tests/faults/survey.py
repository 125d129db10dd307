"""What a store holds after an interruption: its rows as clients know them, and whatever does not fit together."""

from __future__ import annotations

import hashlib
import sqlite3
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from core.errors import DataLoss
from service.adapters.blobs import FileBlobStore
from service.adapters.sql.unit_of_work import SqlTransactions
from service.application.blob_references import blobs_of_submap
from service.application.clouds import CLOUD_BLOB, unpack_cloud
from service.application.identity import TenantId
from service.application.ports import BlobStore, UnitOfWork
from service.application.records import MapRecord, ScanRecord, SessionRecord, SubmapRecord
from tests.faults.history import History, Stored, sequence_violations, violations
from tests.support.records import TENANT


@dataclass(frozen=True)
class Survey:
    """The posted submaps and scans, the last durable scan of each session, and what is wrong in itself."""

    rows: list[Stored] = field(default_factory=list)
    committed: dict[str, int] = field(default_factory=dict)
    states: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)

    def against(self, history: History) -> list[str]:
        """All that is wrong, in itself and by what clients were told."""
        return self.problems + violations(history.operations, self.rows)


def survey(home: Path, tenant: TenantId = TENANT) -> Survey:
    """Open the store with the product's own adapters and look at everything in it."""
    store = SqlTransactions(home / "revisit.db", checkpoints=True)
    blobs = FileBlobStore(home / "blobs")
    try:
        found = store.read(lambda uow: _survey(uow, blobs, tenant)).result()
    finally:
        store.close()
    found.problems.extend(_file_problems(home / "revisit.db"))
    return found


def _survey(uow: UnitOfWork, blobs: BlobStore, tenant: TenantId) -> Survey:
    found = Survey()
    for record in uow.submaps.find(tenant):
        found.states[record.state] += 1
        found.problems.extend(_missing_blobs(record, blobs))
        if record.cloud_sha256 is not None:
            found.rows.extend(_stored(f"submap/{record.submap_id}", record.cloud_sha256, blobs, tenant, found.problems))
    scans = uow.scans.find(tenant)
    for scan in scans:
        found.rows.extend(_stored(f"scan/{scan.seq}", scan.cloud_sha256, blobs, tenant, found.problems))
    for session in uow.sessions.find(tenant):
        found.committed[session.session_id] = session.committed_seq
        found.problems.extend(_session_problems(uow, session, scans))
    for map_record in uow.maps.find(tenant):
        found.problems.extend(_index_problems(uow, map_record))
    found.problems.extend(_job_problems(uow, tenant))
    return found


def _stored(key: str, sha256: str, blobs: BlobStore, tenant: TenantId, problems: list[str]) -> list[Stored]:
    try:
        points = unpack_cloud(blobs.get(tenant, CLOUD_BLOB, sha256)).points
    except DataLoss as error:
        problems.append(f"{key}: {error.message}")
        return [Stored(key, "lost")]
    return [Stored(key, hashlib.sha256(points.tobytes()).hexdigest())]


def _missing_blobs(record: SubmapRecord, blobs: BlobStore) -> Iterator[str]:
    for kind, sha256 in blobs_of_submap(record):
        try:
            blobs.get(record.tenant, kind, sha256)
        except DataLoss as error:
            yield f"submap/{record.submap_id}: {error.message}"


def _session_problems(uow: UnitOfWork, session: SessionRecord, scans: list[ScanRecord]) -> list[str]:
    """The scans are 1, 2, 3, ... up to the committed one; every submap has an ordinal of its own."""
    numbers = [scan.seq for scan in scans if scan.session_id == session.session_id]
    found = sequence_violations(session.session_id, numbers, session.committed_seq)
    of_session = {"map_id": session.map_id, "session_id": session.session_id}
    ordinals = [record.ordinal for record in uow.submaps.find(session.tenant, **of_session)]
    if len(set(ordinals)) < len(ordinals) or any(ordinal >= session.next_ordinal for ordinal in ordinals):
        found.append(f"{session.session_id}: ordinals {ordinals}, next {session.next_ordinal}")
    return found


def _index_problems(uow: UnitOfWork, record: MapRecord) -> list[str]:
    """Replaying the change log gives exactly the described submaps with their descriptors, bit for bit."""
    replayed: dict[int, bytes] = {}
    for change in uow.changes.since(record.tenant, record.number, 0):
        replayed.pop(change.submap_number, None)
        if change.vector is not None:
            replayed[change.submap_number] = change.vector
    submaps = uow.submaps.find(record.tenant, map_id=record.map_id)
    described = {submap.number: submap.descriptor for submap in submaps if submap.state == "DESCRIBED"}
    found = [] if replayed == described else [f"index {sorted(replayed)} != database {sorted(described)}"]
    numbers = {submap.number for submap in submaps}
    loops = uow.loops.find(record.tenant, map_id=record.map_id)
    dangling = [loop.loop_id for loop in loops if not {loop.query_number, loop.match_number} <= numbers]
    return found + [f"{loop_id}: an end of it is gone" for loop_id in dangling]


def _job_problems(uow: UnitOfWork, tenant: TenantId) -> Iterator[str]:
    """A submap waits exactly while its job does, and has ended exactly as its job has."""
    allowed = {"QUEUED": {"QUEUED", "RUNNING"}, "DESCRIBED": {"DONE"}, "FAILED": {"FAILED"}}
    for record in uow.submaps.find(tenant):
        job = uow.jobs.get(tenant, record.operation_id)
        if job is None or job.state not in allowed[record.state]:
            yield f"submap/{record.submap_id} is {record.state}, its job {'gone' if job is None else job.state}"


def _file_problems(database: Path) -> list[str]:
    connection = sqlite3.connect(database)
    try:
        found = [row[0] for row in connection.execute("PRAGMA integrity_check") if row[0] != "ok"]
        return found + [f"dangling reference: {row}" for row in connection.execute("PRAGMA foreign_key_check")]
    finally:
        connection.close()
