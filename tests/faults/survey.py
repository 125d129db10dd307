"""What a store holds after an interruption: its rows as clients know them, and whatever does not fit together."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from sqlalchemy import Connection, Engine

from revisit.core.errors import DataLoss
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import JobRecord, MapRecord, ScanRecord, SessionRecord, SubmapRecord
from revisit.service.engines.local.clock import SystemClock
from revisit.service.engines.local.files.blobs import FileBlobStore
from revisit.service.engines.local.sqlite.connections import writer_engine
from revisit.service.engines.local.sqlite.engine import SqliteEngine
from revisit.service.engines.local.sqlite.store_clock import StoreClock
from revisit.service.engines.postgres.connections import reader_engine
from revisit.service.engines.postgres.engine import PostgresEngine, server_ms
from revisit.service.engines.sql.unit_of_work import SqlUnitOfWork
from revisit.service.features.deletion.blob_references import blobs_of_submap
from revisit.service.features.graph.session_poses import unpack_loops
from revisit.service.features.ingest.clouds import unpack_cloud
from revisit.service.features.loops.rows import LoopStanding
from revisit.service.ports.blobs import CLOUD_BLOB, MAP_LAYOUT_BLOB, PLAN_BLOB, TILE_BLOB, BlobStore
from revisit.service.ports.index import IndexChange
from revisit.service.ports.transactions import UnitOfWork
from tests.faults.history import History, Stored, sequence_violations, violations
from tests.support.records import TENANT
from tests.support.state import ON_POSTGRES, database_of


@dataclass(frozen=True)
class Survey:
    """The posted submaps and scans, the last durable scan of each session, and what is wrong in itself."""

    rows: list[Stored] = field(default_factory=list)
    committed: dict[str, int] = field(default_factory=dict)
    states: Counter[str] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    """Why submaps are FAILED."""
    problems: list[str] = field(default_factory=list)

    def against(self, history: History) -> list[str]:
        """All that is wrong, in itself and by what clients were told."""
        return self.problems + violations(history.operations, self.rows)


def survey(home: Path, tenant: TenantId = TENANT, blobs: BlobStore | None = None) -> Survey:
    """Look at everything in a store. `blobs` are those beside the database, by default the files in `home`."""
    blobs = blobs or FileBlobStore(home / "blobs")
    with opened(home) as (uow, connection):
        found = _survey(uow, blobs, tenant)
        # A server keeps its references itself.
        found.problems.extend([] if ON_POSTGRES else _file_problems(connection))
    return found


@contextmanager
def opened(home: Path) -> Iterator[tuple[UnitOfWork, Connection]]:
    """The store of a home, opened with the product's own adapters as the one writer would."""
    clock = SystemClock()
    engine = reader_engine(database_of(home)) if ON_POSTGRES else _engine(home / "revisit.db")
    speaks = PostgresEngine(server_ms) if ON_POSTGRES else SqliteEngine(StoreClock(clock))
    try:
        with engine.begin() as connection:
            yield SqlUnitOfWork(connection, speaks, 10_000, clock), connection
    finally:
        engine.dispose()


@lru_cache(maxsize=1)
def _engine(database: Path) -> Engine:
    """Engines compile their statements, which takes longer than running them: keep the last, without connections."""
    return writer_engine(database, checkpoints=True)


def _survey(uow: UnitOfWork, blobs: BlobStore, tenant: TenantId) -> Survey:
    found = Survey()
    submaps, scans = uow.submaps.find(tenant), uow.scans.find(tenant)
    copied = {(merge.map_id, name) for merge in uow.map_merges.find(tenant) for name in merge.sessions}
    for record in submaps:
        if (record.map_id, record.session_id) in copied:
            continue
        found.states[record.state] += 1
        found.failures.extend([record.failure_message] if record.failure_message else [])
        found.problems.extend(_missing_blobs(record, blobs))
        if record.cloud_sha256 is not None:
            found.rows.extend(_stored(f"submap/{record.submap_id}", record.cloud_sha256, blobs, tenant, found.problems))
    for scan in scans:
        found.rows.extend(_stored(f"scan/{scan.seq}", scan.cloud_sha256, blobs, tenant, found.problems))
    for anchor in uow.anchors.find(tenant):
        if (anchor.map_id, anchor.session_id) not in copied:
            found.rows.append(Stored(f"anchor/{anchor.anchor_id}", str(anchor.position)))
    for reading in uow.radio_readings.find(tenant):
        if (reading.map_id, reading.session_id) not in copied:
            found.rows.append(Stored(f"radio/{reading.stamp_ns}", reading.heard.hex()))
    for plan in uow.plans.find(tenant):
        found.rows.append(Stored(f"plan/{plan.plan_id}", plan.image_sha256))
    for session in uow.sessions.find(tenant):
        found.committed[session.session_id] = session.committed_seq
        found.problems.extend(_session_problems(session, submaps, scans))
    for map_record in uow.maps.find(tenant):
        found.problems.extend(_index_problems(uow, map_record, submaps))
        found.problems.extend(_number_problems(uow, map_record, submaps))
        found.problems.extend(_version_problems(uow, map_record))
    made = [(TILE_BLOB, row.tile_sha256) for row in uow.map_tiles.find(tenant)]
    made += [(MAP_LAYOUT_BLOB, row.layout_sha256) for row in uow.map_files.find(tenant)]
    made += [(PLAN_BLOB, row.image_sha256) for row in uow.plans.find(tenant)]
    found.problems.extend(f"{kind} {sha256} is gone" for kind, sha256 in made if not blobs.exists(tenant, kind, sha256))
    found.problems.extend(_job_problems(submaps, uow.jobs.find(tenant)))
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


def _session_problems(session: SessionRecord, submaps: list[SubmapRecord], scans: list[ScanRecord]) -> list[str]:
    """The scans are 1, 2, 3, ... up to the committed one; every submap has an ordinal of its own."""
    key = (session.map_id, session.session_id)
    numbers = [scan.seq for scan in scans if (scan.map_id, scan.session_id) == key]
    found = sequence_violations(session.session_id, numbers, session.committed_seq)
    ordinals = [submap.ordinal for submap in submaps if (submap.map_id, submap.session_id) == key]
    if len(set(ordinals)) < len(ordinals) or any(ordinal >= session.next_ordinal for ordinal in ordinals):
        found.append(f"{session.session_id}: ordinals {ordinals}, next {session.next_ordinal}")
    return found


def _index_problems(uow: UnitOfWork, record: MapRecord, submaps: list[SubmapRecord]) -> list[str]:
    """Replaying the change log gives exactly the described submaps with their descriptors, bit for bit."""
    entered: dict[int, IndexChange] = {}
    for change in uow.changes.since(record.tenant, record.number, 0):
        entered.pop(change.submap_number, None)
        if change.whole_session:
            entered = {n: one for n, one in entered.items() if one.session_number != change.session_number}
        if change.vector is not None:
            entered[change.submap_number] = change
    replayed = {number: change.vector for number, change in entered.items()}
    of_map = {submap.number: submap for submap in submaps if submap.map_id == record.map_id}
    described = {number: submap.descriptor for number, submap in of_map.items() if submap.state == "DESCRIBED"}
    found = [] if replayed == described else [f"index {sorted(replayed)} != database {sorted(described)}"]
    loops = uow.loops.find(record.tenant, map_id=record.map_id)
    dangling = [loop.loop_id for loop in loops if not {loop.query_number, loop.match_number} <= of_map.keys()]
    return found + [f"{loop_id}: an end of it is gone" for loop_id in dangling]


def _number_problems(uow: UnitOfWork, record: MapRecord, submaps: list[SubmapRecord]) -> Iterator[str]:
    """No number of the map was given twice, and the counters are behind none of them."""
    tenant, map_id = record.tenant, record.map_id
    numbers = {
        "changes": [change.seq for change in uow.changes.since(tenant, record.number, 0)],
        "events": [event.number for event in uow.events.following(tenant, map_id, 0, 1_000_000)],
        "submaps": [submap.seq for submap in submaps if submap.map_id == map_id],
    }
    for kind, given in numbers.items():
        if len(set(given)) < len(given) or 0 in given:
            yield f"{map_id}: numbers of {kind} are {sorted(given)}"
    last = {"events": uow.events.last_numbers([(tenant, map_id)])[tenant, map_id]}
    last["submaps"] = uow.submaps.last_seq(tenant, map_id)
    for kind, number in last.items():
        if max(numbers[kind], default=0) > number:
            yield f"{map_id}: the last number of {kind} is {number}, one has {max(numbers[kind])}"


def _version_problems(uow: UnitOfWork, record: MapRecord) -> Iterator[str]:
    """The version in force is whole, loops have its verdicts, and the events of each loop give its state."""
    versions = uow.map_versions.distinct(record.tenant, "version", map_id=record.map_id)
    if record.map_version != max(versions, default=0):
        yield f"{record.map_id}: version {record.map_version} is in force, there are {sorted(versions)}"
    for tile in uow.map_tiles.find(record.tenant, map_id=record.map_id):
        if tile.version not in versions:
            yield f"{record.map_id}: {tile.tile_id} is of version {tile.version}, which is gone"
    for version in versions:
        if not uow.session_poses.count(record.tenant, map_id=record.map_id, version=version):
            yield f"{record.map_id}: version {version} has no poses"
    in_force = uow.map_versions.get(record.tenant, record.map_id, record.map_version)
    judged = {} if in_force is None else {loop.number: loop.state for loop in unpack_loops(in_force.loops)}
    for loop in uow.loops.find(record.tenant, map_id=record.map_id):
        if loop.graph_state != judged.get(loop.number):
            yield f"{loop.loop_id} is {loop.graph_state}, the version in force says {judged.get(loop.number)}"
        events = uow.loop_events.find(record.tenant, map_id=record.map_id, loop_id=loop.loop_id)
        if [LoopStanding.of(event) for event in events[-1:]] != [LoopStanding.of(loop)]:
            yield f"{loop.loop_id}: its events say {events[-1:]}"


def _job_problems(submaps: list[SubmapRecord], jobs: list[JobRecord]) -> Iterator[str]:
    """A submap waits, or its loops are looked for, exactly while its job does; it has ended exactly as its job has."""
    waits = {"QUEUED", "RUNNING"}
    allowed = {"QUEUED": waits, "DESCRIBED": {"DONE"}, "FAILED": {"FAILED"}}
    states = {job.operation_id: job.state for job in jobs}
    for submap in submaps:
        state = states.get(submap.operation_id, "gone")
        if state not in (allowed[submap.state] if submap.searched else waits):
            yield f"submap/{submap.submap_id} is {submap.state}, its job {state}"


def _file_problems(connection: Connection) -> list[str]:
    found = [text for (text,) in connection.exec_driver_sql("PRAGMA integrity_check") if text != "ok"]
    return found + [f"dangling reference: {row}" for row in connection.exec_driver_sql("PRAGMA foreign_key_check")]
