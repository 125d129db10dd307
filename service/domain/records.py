"""Records: one database row of each noun. Every record belongs to a tenant and has a `number`.

Numbers are given out by the store when a record is added (0 before), grow with every add, and are never used twice,
so they order lists, page them and stand for a record in the vector index. Poses are 16 floats, row-major.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from revisit.service.domain.identity import SessionKey, SubmapKey, TenantId
from revisit.service.domain.retention import KeptScans
from revisit.service.domain.states import OperationState

Pose = tuple[float, ...]


@dataclass(frozen=True)
class MapRecord:
    """A map; None stands for "as the service is configured"; `model_version` is that of its descriptors, if any.

    `scene_scale` is the size of its scene compared with a street (docs/decisions/0009), `profile` a `Profile`; neither
    ever changes.
    `loop_candidates` to `max_seen_through` are the map's own `LoopPolicy`. `map_version` is the version of its poses in
    force, 0 for none; `graph_edits` counts the changes that made a part of its pose graph void. `index_file` names the
    file that its index may be loaded from. `retention` is its own `RetentionPolicy` as text, None for that of the
    service, and `retention_run` the last run that removed anything, JSON (see `features.retention.reports`).
    `origin`: latitude and longitude, degrees, and altitude, metres, where its anchors measure from; None without any.
    """

    tenant: TenantId
    map_id: str
    content_hash: str
    display_name: str
    tau_m: float | None
    stride_m: float | None
    leave_distance_m: float | None
    model_version: str | None
    created_at_ns: int
    scene_scale: float = 1.0
    loop_candidates: int | None = None
    min_score: float | None = None
    min_overlap: float | None = None
    max_seen_through: float | None = None
    map_version: int = 0
    graph_edits: int = 0
    index_file: str | None = None
    profile: str = "product"
    retention: str | None = None
    retention_run: dict[str, Any] | None = None
    origin: tuple[float, float, float] | None = None
    number: int = 0


@dataclass(frozen=True)
class DeletionRecord:
    """A session of a map, or with "" for `session_id` the map, that is being deleted with all that is in it.

    While it is there, no other row of them is seen (`UnitOfWork.everything` excepted), and their ids are taken.
    """

    tenant: TenantId
    map_id: str
    session_id: str
    created_at_ns: int
    number: int = 0


@dataclass(frozen=True)
class RobotRecord:
    """A robot."""

    tenant: TenantId
    robot_id: str
    content_hash: str
    display_name: str
    created_at_ns: int
    number: int = 0


@dataclass(frozen=True, kw_only=True)
class SessionDetails:
    """What a client may say of a session when it creates it, in its own words; None where it did not. It never changes.

    `storey` is the level of a building that all of the session is driven on, as B2. `drift` is that of its odometry, as
    `core.pose_graph.graph.OdometryModel.stated` reads it. A new detail is a field here and in
    `SessionRecord`, and a column of its name.
    """

    storey: str | None = None
    drift: str | None = None

    @classmethod
    def of(cls, source: Any) -> dict[str, Any]:
        """The details by name, of anything that has attributes of these names."""
        return {detail.name: getattr(source, detail.name) for detail in fields(SessionDetails)}


@dataclass(frozen=True)
class SessionRecord:
    """A session, its details, and where its current window of scans stands (see `ingest.scans`).

    `stream`: the stream that stored the last scan, if one did (see `ingest.appending.ScanStream`). `changes_told`: what
    was told of the changes that its drive found (see `graph.told_changes.DriveChanges`), None where nothing was yet.
    """

    tenant: TenantId
    map_id: str
    session_id: str
    content_hash: str
    robot_id: str | None
    state: str
    committed_seq: int
    next_ordinal: int
    travelled_m: float
    window_start_m: float
    window_first_seq: int
    emitted_to_m: float | None
    created_at_ns: int
    finished_at_ns: int | None
    storey: str | None = None
    drift: str | None = None
    stream: str | None = None
    changes_told: str | None = None
    number: int = 0

    @property
    def key(self) -> SessionKey:
        """The key of the session."""
        return SessionKey(self.map_id, self.session_id)


@dataclass(frozen=True)
class ScanRecord:
    """A scan: its pose, how far the session had travelled, and the blob of its cloud ("" where it is not kept).

    `chosen`: descriptions are made of it (see `core.scan_marks`).
    """

    tenant: TenantId
    map_id: str
    session_id: str
    seq: int
    stamp_ns: int
    T_odom_sensor: Pose
    travelled_m: float
    point_count: int
    cloud_sha256: str
    chosen: bool = False
    number: int = 0


@dataclass(frozen=True)
class SubmapRecord:
    """A submap: one cloud blob, or the scans first_seq..last_seq; and a worker's results.

    `seq` is its number within its map, given with its commit. `entered` is the change by which it entered the index of
    its map, 0 before that, and `map_version` the version in force then. `searched`: its loops with those that entered
    before it are there.
    `radio`: its fingerprint (`core.radio`), None where nobody told any.
    `kept_scans` says which of its clouds are still kept (a `KeptScans`); `described_at_ns` is None in rows of before
    there was the column.
    """

    tenant: TenantId
    map_id: str
    session_id: str
    submap_id: str
    content_hash: str
    state: str
    ordinal: int
    session_number: int
    T_odom_submap: Pose
    position_m: tuple[float, float, float]
    stamp_ns: int
    cloud_sha256: str | None
    first_seq: int | None
    last_seq: int | None
    scan_count: int
    point_count: int
    operation_id: str
    flags: tuple[str, ...]
    created_at_ns: int
    model_version: str | None = None
    descriptor: bytes | None = None
    place_sha256: str | None = None
    neural_map_sha256: str | None = None
    neural_map_bytes: int | None = None
    failure_code: str | None = None
    failure_message: str | None = None
    entered: int = 0
    map_version: int = 0
    searched: bool = True
    seq: int = 0
    described_at_ns: int | None = None
    kept_scans: str = KeptScans.ALL.value
    radio: bytes | None = None
    number: int = 0

    @property
    def key(self) -> SubmapKey:
        """The key of the submap."""
        return SubmapKey(self.map_id, self.session_id, self.submap_id)


@dataclass(frozen=True)
class LoopRecord:
    """A loop closure between two submaps, accepted or rejected, with its evidence.

    `graph_state` is the verdict of the version of the map in force, None where none knows the loop. `manual`: a person
    made it. `seq` is the number of the map's event that accepted it last, 0 where it never was: the engine gives it.
    """

    tenant: TenantId
    map_id: str
    loop_id: str
    query_number: int
    match_number: int
    query_session_id: str
    query_submap_id: str
    match_session_id: str
    match_submap_id: str
    state: str
    reason: str | None
    similarity: float
    score: float
    T_match_query: Pose | None
    evidence: dict[str, Any]
    created_at_ns: int
    graph_state: str | None = None
    manual: bool = False
    seq: int = 0
    number: int = 0

    @property
    def name(self) -> str:
        """The resource name."""
        return f"maps/{self.map_id}/loopClosures/{self.loop_id}"

    @property
    def query(self) -> SubmapKey:
        """The key of the submap that asked."""
        return SubmapKey(self.map_id, self.query_session_id, self.query_submap_id)

    @property
    def match(self) -> SubmapKey:
        """The key of the submap that was found."""
        return SubmapKey(self.map_id, self.match_session_id, self.match_submap_id)

    @classmethod
    def between(cls, query: SubmapRecord, match: SubmapRecord, **fields: Any) -> LoopRecord:
        """A loop closure between two submaps of one map; `fields` are the others."""
        return cls(
            tenant=query.tenant,
            map_id=query.map_id,
            query_number=query.number,
            match_number=match.number,
            query_session_id=query.session_id,
            query_submap_id=query.submap_id,
            match_session_id=match.session_id,
            match_submap_id=match.submap_id,
            **fields,
        )


@dataclass(frozen=True)
class LoopEventRecord:
    """A change of a loop closure: the new `state`, `reason` and `graph_state`, the actor and the note.

    `kind` is a `LoopEventKind`; `details` is JSON: thresholds and model version of a verdict, the distance from the
    poses of a version of the map. The ends are those of the loop, with which its events are deleted.
    """

    tenant: TenantId
    map_id: str
    loop_id: str
    kind: str
    state: str
    reason: str | None
    graph_state: str | None
    T_match_query: Pose | None
    actor: str
    note: str
    map_version: int
    details: dict[str, Any]
    query_number: int
    match_number: int
    query_session_id: str
    match_session_id: str
    at_ns: int
    number: int = 0


@dataclass(frozen=True)
class MapVersionRecord:
    """A version of a map's poses (see `SessionPosesRecord`), and its verdict on each loop, packed.

    `loops` holds, of every loop that it judged, its number, its state and its squared distance from the poses (see
    `contract.session_poses`); `loops_hash` is that of `loops`. `anchors` are the verdicts on anchors, packed (see
    `features.graph.anchor_verdicts`); None where there were none.
    """

    tenant: TenantId
    map_id: str
    version: int
    restored_from: int | None
    operation_id: str | None
    summary: dict[str, Any]
    loops: bytes
    loops_hash: str
    created_at_ns: int
    anchors: bytes | None = None
    number: int = 0


@dataclass(frozen=True)
class SessionPosesRecord:
    """The poses of a session in a version of a map, packed (see `contract.session_poses`); `content_hash` is of them.

    `frame` names the frame of the map that they are in. Those of one session are together, so that they go with it.
    """

    tenant: TenantId
    map_id: str
    version: int
    session_id: str
    session_number: int
    frame: str
    T_map_odom: Pose
    submaps: bytes
    content_hash: str
    created_at_ns: int
    number: int = 0


@dataclass(frozen=True)
class AnchorRecord:
    """The place in the world of a point of a robot at `stamp_ns`, of a kind of `AnchorKind`.

    `position` is latitude and longitude, degrees, and altitude, metres, where `frame` is WGS84; metres east, north and
    above the origin of the map where it is LOCAL. covariance, 9 numbers of east, north and up, m^2; offset_m, the point
    in the frame of the sensor; heading_rad, of the sensor's x axis, counter-clockwise from east. Where `frame` is TAG,
    the point is the `tag` of that family and id, position says nothing, and covariance is along the sensor's axes.
    """

    tenant: TenantId
    map_id: str
    session_id: str
    anchor_id: str
    content_hash: str
    kind: str
    frame: str
    stamp_ns: int
    position: tuple[float, float, float]
    covariance: tuple[float, ...]
    offset_m: tuple[float, float, float]
    T_odom_sensor: Pose
    heading_rad: float | None
    heading_sigma_rad: float | None
    created_at_ns: int
    tag: str | None = None
    number: int = 0

    @property
    def name(self) -> str:
        """The resource name."""
        return f"{SessionKey(self.map_id, self.session_id).name}/anchors/{self.anchor_id}"


@dataclass(frozen=True)
class RadioReadingRecord:
    """The access points that a robot heard at `stamp_ns`, as bytes of a `core.radio.RadioFingerprint`.

    `time_slice`: which ten seconds that was in (see `features.radio.rows`).
    """

    tenant: TenantId
    map_id: str
    session_id: str
    stamp_ns: int
    time_slice: int
    heard: bytes
    number: int = 0


@dataclass(frozen=True)
class EarlyCorrectionRecord:
    """T_map_odom of a session by version `version` of its map and by single `loops` that were asked since, ahead of the
    next version. It says nothing of another version than this one.
    """

    tenant: TenantId
    map_id: str
    session_id: str
    version: int
    loops: int
    T_map_odom: Pose
    created_at_ns: int
    number: int = 0


@dataclass(frozen=True)
class MapMergeRecord:
    """A merge into a map: the source, the new version and the evidence.

    `merge_id` is the id of its operation. `source` is the resource name of the map or session that was copied;
    `sessions` are the ids of the copies. `version_before` was in force before it (0 for none) and is kept while the
    merge is; `report` is JSON (see `mapping.merge_report`). `reverted_at_ns` is there once the merge was taken back.
    """

    tenant: TenantId
    map_id: str
    merge_id: str
    source: str
    version_before: int
    version: int
    sessions: tuple[str, ...]
    report: dict[str, Any]
    created_at_ns: int
    reverted_at_ns: int | None = None
    number: int = 0


@dataclass(frozen=True)
class MapTileRecord:
    """A tile of a version of a map that a worker has made: its content, and that of how many submaps it was made."""

    tenant: TenantId
    map_id: str
    version: int
    tile_id: str
    tile_sha256: str
    submaps: int
    created_at_ns: int
    number: int = 0


@dataclass(frozen=True)
class MapFileRecord:
    """A version of a map as one file: its hash and size, the ids of its sessions, and the blob that says its bytes.

    One file of a map has the `state` ENABLED at most, the others are DISABLED; `description` is in an operator's words.
    """

    tenant: TenantId
    map_id: str
    version: int
    sha256: str
    size_bytes: int
    layout_sha256: str
    sessions: tuple[str, ...]
    submaps: int
    state: str
    description: str
    created_at_ns: int
    number: int = 0


@dataclass(frozen=True)
class PlanRecord:
    """A picture underneath a map, by the hash of its bytes.

    `pins` are two rows of numbers (see `features.plans.rules.HeldPin`), set in `frame` of the map, "" where it had no
    version. `storey` is None where it shows none.
    """

    tenant: TenantId
    map_id: str
    plan_id: str
    content_hash: str
    display_name: str
    storey: str | None
    media_type: str
    width_px: int
    height_px: int
    size_bytes: int
    image_sha256: str
    frame: str
    pins: tuple[tuple[float, ...], ...]
    created_at_ns: int
    number: int = 0

    @property
    def name(self) -> str:
        """The resource name."""
        return f"maps/{self.map_id}/plans/{self.plan_id}"


@dataclass(frozen=True)
class JobRecord:
    """A leased job, which clients see as an operation.

    Of a tenant's jobs those of `priority` 0, for which a client waits, go before those of 1, and these before those of
    2, which may wait. `lease_id` is drawn at random for each claim: only the holder of the newest may complete
    the job (fencing). Lease times are of the store's clock; `claimed_ms` is when the last run began. `forgiven` of the
    `attempts` ended for a reason that was none of the job's (docs/decisions/0082). `progress` is JSON (stage, done,
    total, and what a merge goes on with in its next run), and `cancel_requested` says that somebody wants it to end.
    `request_id` and `traceparent` (W3C) name the request that the job came from.
    """

    tenant: TenantId
    operation_id: str
    kind: str
    state: str
    subject: str
    payload: dict[str, Any]
    attempts: int
    max_attempts: int
    created_at_ns: int
    priority: int = 1
    lease_owner: str | None = None
    lease_id: str = ""
    claimed_ms: int = 0
    not_before_ms: int = 0
    lease_expires_ms: int = 0
    request_id: str | None = None
    traceparent: str | None = None
    result: dict[str, Any] | None = None
    failure_code: str | None = None
    failure_message: str | None = None
    finished_at_ns: int | None = None
    forgiven: int = 0
    progress: dict[str, Any] | None = None
    cancel_requested: bool = False
    number: int = 0

    @property
    def done(self) -> bool:
        """Whether it has ended, well or not."""
        return self.state in (OperationState.DONE, OperationState.FAILED)

    @property
    def counted_attempts(self) -> int:
        """The attempts that count against `max_attempts`."""
        return self.attempts - self.forgiven


@dataclass(frozen=True)
class TurnRecord:
    """How much of the workers' time a tenant has had, milliseconds, on a scale that all tenants share.

    A tenant that had nothing to do is lifted to where the others stand; `started_ms` is where its last job began.
    """

    tenant: TenantId
    started_ms: int = 0
    ran_ms: int = 0
    lifted_ms: int = 0

    @property
    def spent_ms(self) -> int:
        """Where it stands."""
        return self.ran_ms + self.lifted_ms


@dataclass(frozen=True)
class WorkerRecord:
    """A worker process and when it last showed itself, by the store's clock."""

    worker_id: str
    model_version: str
    seen_ms: int
