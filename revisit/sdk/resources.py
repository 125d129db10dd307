"""What the service answers, as frozen dataclasses made from the messages that both transports give."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any, Self

import numpy as np
from google.protobuf.json_format import MessageToDict
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.v1 import (
    event_pb2,
    geometry_pb2,
    loop_closure_pb2,
    map_file_pb2,
    map_pb2,
    map_tile_pb2,
    mapping_pb2,
    operation_pb2,
    robot_pb2,
    session_pb2,
    submap_pb2,
    system_pb2,
    webhook_pb2,
)

Json = dict[str, Any]
Matrix4 = NDArray[np.float64]


def pose_json(T_target_source: Any) -> Json:
    """A (4, 4) or (3, 4) transform as the JSON of a Transform. Raises core.errors.BadTransform."""
    transform = se3.validated(T_target_source)
    translation = dict(zip("xyz", (float(v) for v in transform[:3, 3]), strict=True))
    rotation = dict(zip("xyzw", (float(v) for v in se3.to_quaternion(transform)), strict=True))
    return {"translation": translation, "rotation": rotation}


@dataclass(frozen=True)
class LoopPolicy:
    """Which loop closures are accepted; None stands for the value of the service.

    `candidates`: submaps that are verified for each new one. A candidate is accepted with a score of at least
    `min_score` and an overlap of at least `min_overlap`, where at most `max_seen_through` of it was looked through.
    """

    candidates: int | None = None
    min_score: float | None = None
    min_overlap: float | None = None
    max_seen_through: float | None = None

    @classmethod
    def of(cls, message: map_pb2.LoopPolicy) -> Self:
        """From its message."""
        return cls(**{item.name: _optional(message, item.name) for item in fields(cls)})


@dataclass(frozen=True)
class Map:
    """A map; `scene_scale` is the size of its scene compared with a street, `loop_policy` has the values in force.

    `map_version` is the version of its poses that answers rest on, 0 before the first.
    """

    name: str
    display_name: str
    tau_m: float
    stride_m: float
    leave_distance_m: float
    scene_scale: float
    session_count: int
    submap_count: int
    created_at_ns: int
    loop_policy: LoopPolicy = LoopPolicy()
    map_version: int = 0

    @classmethod
    def of(cls, message: map_pb2.Map) -> Self:
        """From its message."""
        return cls(
            name=message.name,
            display_name=message.display_name,
            tau_m=message.tau_m,
            stride_m=message.stride_m,
            leave_distance_m=message.leave_distance_m,
            scene_scale=message.scene_scale,
            session_count=message.session_count,
            submap_count=message.submap_count,
            created_at_ns=message.created_at_ns,
            loop_policy=LoopPolicy.of(message.loop_policy),
            map_version=message.map_version,
        )


@dataclass(frozen=True)
class MapPose:
    """A pose (4, 4) in a frame of the map, by a version of the map; poses of different frames cannot be compared."""

    T_map: Matrix4 = field(compare=False)
    frame: str
    map_version: int


@dataclass(frozen=True)
class Robot:
    """A robot."""

    name: str
    display_name: str
    created_at_ns: int

    @classmethod
    def of(cls, message: robot_pb2.Robot) -> Self:
        """From its message."""
        return cls(message.name, message.display_name, message.created_at_ns)


@dataclass(frozen=True)
class Finding:
    """Something about scans that is unlikely to be meant, in so many submaps: its likely cause, and what to do."""

    code: str
    submaps: int
    cause: str
    advice: str

    @classmethod
    def of(cls, message: session_pb2.Finding) -> Self:
        """From its message."""
        return cls(message.code, message.submaps, message.cause, message.advice)


@dataclass(frozen=True)
class NoLoops:
    """Why a session has no accepted loop: a code, and the same in words, with figures."""

    code: str
    message: str


@dataclass(frozen=True)
class Session:
    """A session; `committed_seq` is the last scan that is stored durably, 0 for none, taken at `committed_stamp_ns`.

    `findings` say what is unlikely to be meant about its scans so far; `no_loops` why it has no accepted loop, once it
    is finished and described. Neither is in lists of sessions. `storey` is None where nobody said it.
    """

    name: str
    robot: str | None
    state: str
    committed_seq: int
    travelled_m: float
    submap_count: int
    created_at_ns: int
    finished_at_ns: int | None
    committed_stamp_ns: int | None
    findings: tuple[Finding, ...] = ()
    storey: str | None = None
    no_loops: NoLoops | None = None

    @classmethod
    def of(cls, message: session_pb2.Session) -> Self:
        """From its message."""
        return cls(
            name=message.name,
            robot=message.robot or None,
            state=_word(message, "state"),
            committed_seq=message.committed_seq,
            travelled_m=message.travelled_m,
            submap_count=message.submap_count,
            created_at_ns=message.created_at_ns,
            finished_at_ns=_optional(message, "finished_at_ns"),
            committed_stamp_ns=_optional(message, "committed_stamp_ns"),
            findings=tuple(Finding.of(finding) for finding in message.findings),
            storey=message.storey or None,
            no_loops=NoLoops(message.no_loops.code, message.no_loops.message) if message.HasField("no_loops") else None,
        )


@dataclass(frozen=True)
class Operation:
    """Work that goes on after the answer; `result` once DONE, `failure_reason` once FAILED.

    `seq` is that of the submap, where `post_submap` returned the operation: the `min_seq` of a query that must see it.
    `progress` is there while it optimises or merges maps; `cancel_requested` says that it is asked to end.
    """

    name: str
    kind: str
    state: str
    subject: str
    attempts: int
    result: Json | None
    failure_reason: str | None
    failure_message: str | None
    seq: int | None = field(default=None, compare=False)
    progress: OperationProgress | None = field(default=None, compare=False)
    cancel_requested: bool = field(default=False, compare=False)

    @property
    def done(self) -> bool:
        """Whether it has ended, well or not."""
        return self.state in ("DONE", "FAILED")

    @classmethod
    def of(cls, message: operation_pb2.Operation) -> Self:
        """From its message."""
        return cls(
            name=message.name,
            kind=_word(message, "kind"),
            state=_word(message, "state"),
            subject=message.subject,
            attempts=message.attempts,
            result=_json(message, "result"),
            failure_reason=message.failure.reason or None,
            failure_message=message.failure.message or None,
            progress=OperationProgress.of(message.progress) if message.HasField("progress") else None,
            cancel_requested=message.cancel_requested,
        )


@dataclass(frozen=True)
class OperationProgress:
    """How far an operation has come: `done` of `total` parts of a stage."""

    stage: str
    done: int
    total: int

    @classmethod
    def of(cls, message: operation_pb2.OperationProgress) -> Self:
        """From its message."""
        return cls(message.stage, message.done, message.total)


@dataclass(frozen=True)
class Submap:
    """A submap; sizes in bytes, the position in the session's odometry frame.

    `descriptor` is there where the full view was asked for and the submap is described. `seq` grows with every submap
    of the service: a query with it as `min_seq` sees this submap. `in_map` is T_map_submap where its session has a
    frame.
    """

    name: str
    state: str
    ordinal: int
    T_odom_submap: Matrix4 = field(compare=False)
    position_m: tuple[float, float, float]
    stamp_ns: int
    first_seq: int | None
    last_seq: int | None
    scan_count: int
    point_count: int
    raw_bytes: int
    neural_map_bytes: int | None
    flags: tuple[str, ...]
    model_version: str | None
    operation: str
    descriptor: tuple[float, ...] = ()
    seq: int = 0
    in_map: MapPose | None = field(default=None, compare=False)

    @classmethod
    def of(cls, message: submap_pb2.Submap) -> Self:
        """From its message."""
        return cls(
            name=message.name,
            state=_word(message, "state"),
            ordinal=message.ordinal,
            T_odom_submap=_matrix(message.t_odom_submap),
            position_m=_vector(message.position_m),
            stamp_ns=message.stamp_ns,
            first_seq=_optional(message, "first_seq"),
            last_seq=_optional(message, "last_seq"),
            scan_count=message.scan_count,
            point_count=message.point_count,
            raw_bytes=message.raw_bytes,
            neural_map_bytes=_optional(message, "neural_map_bytes"),
            flags=tuple(message.flags),
            model_version=message.model_version or None,
            operation=message.operation,
            descriptor=tuple(message.place_descriptor),
            seq=message.seq,
            in_map=_map_pose(message, "t_map_submap"),
        )


@dataclass(frozen=True)
class SearchHit:
    """A submap and its cosine similarity to the query; `in_map` is T_map_submap where its session has a frame."""

    submap: str
    similarity: float
    position_m: tuple[float, float, float]
    in_map: MapPose | None = field(default=None, compare=False)

    @classmethod
    def of(cls, message: loop_closure_pb2.SearchHit) -> Self:
        """From its message."""
        in_map = _map_pose(message, "t_map_submap")
        return cls(message.submap, message.similarity, _vector(message.position_m), in_map)


@dataclass(frozen=True)
class Candidate:
    """A submap that was compared with a cloud: accepted with a transform, or rejected for a reason."""

    submap: str
    accepted: bool
    reason: str | None
    similarity: float
    score: float
    T_match_query: Matrix4 | None = field(compare=False)
    evidence: Json

    @classmethod
    def of(cls, message: loop_closure_pb2.LocalizedCandidate) -> Self:
        """From its message."""
        return cls(
            submap=message.submap,
            accepted=message.accepted,
            reason=message.reason or None,
            similarity=message.similarity,
            score=message.score,
            T_match_query=_optional_matrix(message, "t_match_query"),
            evidence=_json(message, "evidence") or {},
        )


@dataclass(frozen=True)
class Localization:
    """The best verified candidate, None where the place is unknown, and all that were compared.

    `T_odom_query` (4, 4) is the cloud's pose in the odometry frame of `session`, the session of the best candidate;
    `in_map` is T_map_query where that session has a frame. `on_other_storeys` submaps were not compared, as their
    sessions are on another storey than was said.
    """

    best: Candidate | None
    T_odom_query: Matrix4 | None = field(compare=False)
    session: str | None
    candidates: tuple[Candidate, ...]
    in_map: MapPose | None = field(default=None, compare=False)
    on_other_storeys: int = 0

    @classmethod
    def of(cls, message: loop_closure_pb2.LocalizeResponse) -> Self:
        """From its message."""
        return cls(
            best=Candidate.of(message.best) if message.HasField("best") else None,
            T_odom_query=_optional_matrix(message, "t_odom_query"),
            session=message.session or None,
            candidates=tuple(Candidate.of(candidate) for candidate in message.candidates),
            in_map=_map_pose(message, "t_map_query"),
            on_other_storeys=message.on_other_storeys,
        )


@dataclass(frozen=True)
class LoopClosure:
    """A pair of submaps that look alike, with the verdict; `T_match_query` maps query-frame points to match-frame."""

    name: str
    number: int
    query: str
    match: str
    state: str
    reason: str | None
    similarity: float
    score: float
    T_match_query: Matrix4 | None = field(compare=False)
    evidence: Json
    created_at_ns: int
    graph_state: str | None = None
    manual: bool = False
    in_map: MapPose | None = field(default=None, compare=False)
    T_map_match: Matrix4 | None = field(default=None, compare=False)

    @classmethod
    def of(cls, message: loop_closure_pb2.LoopClosure) -> Self:
        """From its message."""
        return cls(
            name=message.name,
            number=message.number,
            query=message.query,
            match=message.match,
            state=_word(message, "state"),
            reason=message.reason or None,
            similarity=message.similarity,
            score=message.score,
            T_match_query=_optional_matrix(message, "t_match_query"),
            evidence=_json(message, "evidence") or {},
            created_at_ns=message.created_at_ns,
            graph_state=_word(message, "graph_state") if message.graph_state else None,
            manual=message.manual,
            in_map=_map_pose(message, "t_map_query"),
            T_map_match=_optional_matrix(message, "t_map_match"),
        )


@dataclass(frozen=True)
class KeypointPlan:
    """The keypoints (n, 2) of a submap, metres in its upright frame; T_submap_level (4, 4) is where that lies."""

    submap: str
    T_submap_level: Matrix4 = field(compare=False)
    keypoints: NDArray[np.float64] = field(compare=False)

    @classmethod
    def of(cls, message: loop_closure_pb2.KeypointPlan) -> Self:
        """From its message."""
        return cls(message.submap, _matrix(message.t_submap_level), np.stack([message.x, message.y], axis=1))


@dataclass(frozen=True)
class LoopKeypoints:
    """What was compared for a loop closure, as the method saw both submaps from above.

    pairs (p, 2): rows of the keypoints of query and match that look alike, the most alike first; agrees (p,): whether
    the pose of the loop closure brings them together.
    """

    query: KeypointPlan
    match: KeypointPlan
    pairs: NDArray[np.int64] = field(compare=False)
    agrees: NDArray[np.bool_] = field(compare=False)

    @classmethod
    def of(cls, message: loop_closure_pb2.GetLoopClosureKeypointsResponse) -> Self:
        """From its message."""
        pairs = np.array([(pair.query, pair.match) for pair in message.pairs], dtype=np.int64).reshape(-1, 2)
        agrees = np.array([pair.agrees for pair in message.pairs], dtype=bool)
        return cls(KeypointPlan.of(message.query), KeypointPlan.of(message.match), pairs, agrees)


@dataclass(frozen=True)
class LoopClosureEvent:
    """A change of a loop closure: its state from then on, who made it, and why.

    `details` holds thresholds and model version of a verdict, or the squared distance from the poses of a version.
    """

    number: int
    kind: str
    state: str
    reason: str | None
    graph_state: str | None
    T_match_query: Matrix4 | None = field(compare=False)
    actor: str
    note: str
    map_version: int | None
    details: Json
    at_ns: int

    @classmethod
    def of(cls, message: loop_closure_pb2.LoopClosureEvent) -> Self:
        """From its message."""
        return cls(
            number=message.number,
            kind=_word(message, "kind"),
            state=_word(message, "state"),
            reason=message.reason or None,
            graph_state=_word(message, "graph_state") if message.graph_state else None,
            T_match_query=_optional_matrix(message, "t_match_query"),
            actor=message.actor,
            note=message.note,
            map_version=message.map_version or None,
            details=_json(message, "details") or {},
            at_ns=message.at_ns,
        )


@dataclass(frozen=True)
class MapChange:
    """Something that one day has and the other has not: `kind` VANISHED or APPEARED.

    A box along the axes of the map's frame: centre and extent (3,) in metres, around so many neural `points`.
    """

    kind: str
    centre_m: tuple[float, float, float]
    extent_m: tuple[float, float, float]
    points: int

    @classmethod
    def of(cls, message: mapping_pb2.MapChange) -> Self:
        """From its message."""
        centre, extent = message.centre_m, message.extent_m
        return cls(
            kind=_word(message, "kind"),
            centre_m=(centre.x, centre.y, centre.z),
            extent_m=(extent.x, extent.y, extent.z),
            points=message.points,
        )


@dataclass(frozen=True)
class MapMerge:
    """A merge into a map: `source` was copied as `sessions`, version `version_before` became `version`.

    `report` has alignment and evidence; `changes` are what vanished since the map was made, and what appeared;
    `reverted_at_ns` is there once it was taken back.
    """

    name: str
    source: str
    version_before: int
    version: int
    sessions: tuple[str, ...]
    report: dict[str, Any] = field(compare=False)
    changes: tuple[MapChange, ...]
    created_at_ns: int
    reverted_at_ns: int | None

    @classmethod
    def of(cls, message: mapping_pb2.MapMerge) -> Self:
        """From its message."""
        return cls(
            name=message.name,
            source=message.source,
            version_before=message.version_before,
            version=message.version,
            sessions=tuple(message.sessions),
            report=_json(message, "report") or {},
            changes=tuple(MapChange.of(one) for one in message.changes),
            created_at_ns=message.created_at_ns,
            reverted_at_ns=_optional(message, "reverted_at_ns"),
        )


@dataclass(frozen=True)
class MapVersion:
    """A version of a map's poses. `summary` says what it rests on; `restored_from` is None where it was optimised."""

    name: str
    version: int
    in_force: bool
    restored_from: int | None
    content_hash: str
    operation: str | None
    summary: MapVersionSummary
    created_at_ns: int

    @classmethod
    def of(cls, message: mapping_pb2.MapVersion) -> Self:
        """From its message."""
        return cls(
            name=message.name,
            version=message.version,
            in_force=message.in_force,
            restored_from=message.restored_from or None,
            content_hash=message.content_hash,
            operation=message.operation or None,
            summary=MapVersionSummary.of(message.summary),
            created_at_ns=message.created_at_ns,
        )


@dataclass(frozen=True)
class MapTile:
    """A square of a version of a map, in metres of the frame seen from above; `submaps` may reach into it.

    One that was `made` can be downloaded at once; others are made by a worker then.
    """

    name: str
    frame: str
    min_m: tuple[float, float]
    max_m: tuple[float, float]
    submaps: int
    made: bool

    @classmethod
    def of(cls, message: map_tile_pb2.MapTile) -> Self:
        """From its message."""
        lower, upper = (message.min_x_m, message.min_y_m), (message.max_x_m, message.max_y_m)
        return cls(message.name, message.frame, lower, upper, message.submaps, message.made)


@dataclass(frozen=True)
class MapDistances:
    """Signed distances (n,) of points to the surface of a map, metres, positive in free space, cut at a truncation.

    `nearest_m` (n,) says how far the nearest neural point is. Both are NaN where nothing was seen near.
    """

    map_version: int
    frame: str
    distance_m: NDArray[np.float64] = field(compare=False)
    nearest_m: NDArray[np.float64] = field(compare=False)

    @classmethod
    def of(cls, message: map_tile_pb2.MeasureMapDistancesResponse) -> Self:
        """From its message."""
        columns = [
            np.array([_given(one, name) for one in message.distances], dtype=np.float64)
            for name in ("distance_m", "nearest_m")
        ]
        return cls(message.map_version, message.frame, columns[0], columns[1])


@dataclass(frozen=True)
class MapPoints:
    """Points (n, 3) of the surface of a map around one, with unit normals (n, 3), the nearest first; `total` in all."""

    map_version: int
    frame: str
    positions: NDArray[np.float64] = field(compare=False)
    normals: NDArray[np.float64] = field(compare=False)
    total: int

    @classmethod
    def of(cls, message: map_tile_pb2.FindMapPointsResponse) -> Self:
        """From its message."""
        rows = [(p.x, p.y, p.z, n.x, n.y, n.z) for p, n in ((one.position_m, one.normal) for one in message.points)]
        table = np.array(rows, dtype=np.float64).reshape(-1, 6)
        return cls(message.map_version, message.frame, table[:, :3], table[:, 3:], message.total)


@dataclass(frozen=True)
class MapFile:
    """A version of a map as one file, in the words of VDA 5050; `map_status` is ENABLED or DISABLED."""

    name: str
    map_id: str
    map_version: str
    map_status: str
    map_descriptor: str
    map_download_link: str
    map_hash: str
    size_bytes: int
    submaps: int
    created_at_ns: int

    @classmethod
    def of(cls, message: map_file_pb2.MapFile) -> Self:
        """From its message."""
        given = {one.name: getattr(message, one.name) for one in fields(cls) if one.name != "map_status"}
        return cls(**given, map_status=_word(message, "map_status"))


@dataclass(frozen=True)
class RefusedJoin:
    """Sessions, by name on both sides, that `loops` would join and whose surfaces contradict it.

    reason: OVERLAP_TOO_SMALL, SURFACES_DISAGREE or FREE_SPACE_VIOLATED; residual_m, median distance of the common
    points from the other surface, metres, None without any; seen_through_share of the points, 0 to 1, stand where the
    other side looked through.
    """

    sessions: tuple[str, ...]
    other_sessions: tuple[str, ...]
    reason: str
    loops: int
    common_points: int
    residual_m: float | None
    seen_through_share: float

    @classmethod
    def of(cls, message: mapping_pb2.RefusedJoin) -> Self:
        """From its message."""
        return cls(
            tuple(message.sessions),
            tuple(message.other_sessions),
            message.reason,
            message.loops,
            message.common_points,
            _optional(message, "residual_m"),
            message.seen_through_share,
        )


@dataclass(frozen=True)
class MapVersionSummary:
    """What a version of a map rests on.

    `frames` counts the groups of sessions that loops join; chi2 is to be compared with `degrees_of_freedom`; changes
    are how far submaps lie from where the version before had them, metres, None where none can be compared;
    `refused_joins` are what surfaces kept apart.
    """

    sessions: int
    submaps: int
    frames: int
    loops_in_map: int
    loops_set_aside: int
    loops_unconnected: int
    chi2: float
    degrees_of_freedom: int
    mean_change_m: float | None
    max_change_m: float | None
    refused_joins: tuple[RefusedJoin, ...] = ()

    @classmethod
    def of(cls, message: mapping_pb2.MapVersionSummary) -> Self:
        """From its message."""
        special = ("mean_change_m", "max_change_m", "refused_joins")
        given = {item.name: getattr(message, item.name) for item in fields(cls) if item.name not in special}
        refused = tuple(RefusedJoin.of(one) for one in message.refused_joins)
        changes = {name: _optional(message, name) for name in special[:2]}
        return cls(**given, **changes, refused_joins=refused)


@dataclass(frozen=True)
class SubmapPose:
    """Where a submap lies in a frame of the map; covariance (6, 6) of (x, y, z, rx, ry, rz) in the submap's frame.

    The covariance is NaN where the graph does not tell it.
    """

    submap: str
    T_map_submap: Matrix4 = field(compare=False)
    frame: str
    covariance: Matrix4 = field(compare=False)

    @classmethod
    def of(cls, message: mapping_pb2.SubmapPose) -> Self:
        """From its message."""
        return cls(message.submap, _matrix(message.t_map_submap), message.frame, _covariance(message))


@dataclass(frozen=True)
class Correction:
    """Where the odometry frame of a session lies in the map: T_map_odom @ T_odom_sensor is a sensor's pose in the map.

    Poses of the same `frame` are in one map. `covariance` (6, 6) of (x, y, z, rx, ry, rz) in the frame of the last
    submap that the version `map_version` has. `early_loops` is not 0 where loops that came after that version have
    moved the session already: then it is provisional, until the next version.
    """

    session: str
    T_map_odom: Matrix4 = field(compare=False)
    frame: str
    map_version: int
    covariance: Matrix4 = field(compare=False)
    created_at_ns: int
    early_loops: int = 0

    @classmethod
    def of(cls, message: mapping_pb2.Correction) -> Self:
        """From its message."""
        return cls(
            session=message.session,
            T_map_odom=_matrix(message.t_map_odom),
            frame=message.frame,
            map_version=message.map_version,
            covariance=_covariance(message),
            created_at_ns=message.created_at_ns,
            early_loops=message.early_loops,
        )


@dataclass(frozen=True)
class Event:
    """Something that happened in a map: `kind` LOOP_CLOSURE, OPERATION or MAP_VERSION, with it as it stands by now.

    FORGOTTEN says that earlier events were asked for and are no longer kept: list again what is of interest.
    """

    number: int
    kind: str
    map: str
    loop_closure: LoopClosure | None = None
    operation: Operation | None = None
    map_version: MapVersion | None = None

    @classmethod
    def of(cls, message: event_pb2.Event) -> Self:
        """From its message."""
        return cls(
            number=message.number,
            kind=_word(message, "kind"),
            map=message.map,
            loop_closure=LoopClosure.of(message.loop_closure) if message.HasField("loop_closure") else None,
            operation=Operation.of(message.operation) if message.HasField("operation") else None,
            map_version=MapVersion.of(message.map_version) if message.HasField("map_version") else None,
        )


@dataclass(frozen=True)
class Webhook:
    """Where events are sent; `secret` is there in the answer that created it, and nowhere else.

    `told` is the number of the last event that was dealt with, `failures` counts attempts in vain since then; `state`
    ENABLED or SUSPENDED.
    """

    name: str
    url: str
    map: str | None
    kinds: tuple[str, ...]
    state: str
    told: int
    failures: int
    secret: str = field(default="", repr=False, compare=False)

    @classmethod
    def of(cls, message: webhook_pb2.Webhook, secret: str = "") -> Self:
        """From its message."""
        return cls(
            name=message.name,
            url=message.url,
            map=message.map or None,
            kinds=tuple(event_pb2.Event.Kind.Name(kind) for kind in message.kinds),
            state=_word(message, "state"),
            told=message.told,
            failures=message.failures,
            secret=secret,
        )


@dataclass(frozen=True)
class WebhookDelivery:
    """One attempt to deliver events: the HTTP status of the answer, or None and the `error`."""

    first_event: int
    last_event: int
    events: int
    attempt: int
    status: int | None
    error: str | None
    took_ms: int
    at_ns: int

    @classmethod
    def of(cls, message: webhook_pb2.WebhookDelivery) -> Self:
        """From its message."""
        values = {item.name: getattr(message, item.name) for item in fields(cls)}
        return cls(**{**values, "status": message.status or None, "error": message.error or None})


@dataclass(frozen=True)
class Status:
    """What the service is doing."""

    version: str
    model_version: str | None
    queued_jobs: int
    running_jobs: int
    failed_jobs: int
    indexed_submaps: int
    workers: tuple[str, ...]

    @classmethod
    def of(cls, message: system_pb2.GetStatusResponse) -> Self:
        """From its message."""
        return cls(
            version=message.version,
            model_version=message.model_version or None,
            queued_jobs=message.queued_jobs,
            running_jobs=message.running_jobs,
            failed_jobs=message.failed_jobs,
            indexed_submaps=message.indexed_submaps,
            workers=tuple(worker.worker_id for worker in message.workers),
        )


def _word(message: Any, name: str) -> str:
    """The name of an enum's value."""
    values = message.DESCRIPTOR.fields_by_name[name].enum_type.values_by_number
    number = getattr(message, name)
    return str(values[number].name) if number in values else str(number)


def _optional(message: Any, name: str) -> Any:
    return getattr(message, name) if message.HasField(name) else None


def _json(message: Any, name: str) -> Json | None:
    return MessageToDict(getattr(message, name)) if message.HasField(name) else None


def _optional_matrix(message: Any, name: str) -> Matrix4 | None:
    return _matrix(getattr(message, name)) if message.HasField(name) else None


def _map_pose(message: Any, name: str) -> MapPose | None:
    T_map = _optional_matrix(message, name)
    return None if T_map is None else MapPose(T_map, message.frame, message.map_version)


def _covariance(message: Any) -> Matrix4:
    if not message.covariance:
        return np.full((6, 6), np.nan)
    return np.array(message.covariance, dtype=np.float64).reshape(6, 6)


def _matrix(message: geometry_pb2.Transform) -> Matrix4:
    q = message.rotation
    return se3.from_quaternion((q.x, q.y, q.z, q.w), _vector(message.translation))


def _vector(message: geometry_pb2.Vector3) -> tuple[float, float, float]:
    return message.x, message.y, message.z


def _given(message: map_tile_pb2.MapDistance, name: str) -> float:
    """A number, NaN where it is absent."""
    return float(getattr(message, name)) if message.HasField(name) else float("nan")
