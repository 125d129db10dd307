"""Answers of the service as frozen dataclasses, made from the messages of both transports."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.sdk.reading import Json, Matrix4, Read, Resource, covariance_of, matrix, read_by, vector_of


def pose_json(T_target_source: Any) -> Json:
    """A (4, 4) or (3, 4) transform as the JSON of a Transform. Raises core.errors.BadTransform."""
    transform = se3.validated(T_target_source)
    translation = dict(zip("xyz", (float(v) for v in transform[:3, 3]), strict=True))
    rotation = dict(zip("xyzw", (float(v) for v in se3.to_quaternion(transform)), strict=True))
    return {"translation": translation, "rotation": rotation}


def _in_map(pose: str) -> Read:
    """A pose in the map: the transform in the field `pose`, with its frame and version."""

    def read(message: Any) -> MapPose | None:
        if not message.HasField(pose):
            return None
        return MapPose(matrix(getattr(message, pose)), message.frame, message.map_version)

    return read


def _pairs(message: Any) -> NDArray[np.int64]:
    return np.array([(pair.query, pair.match) for pair in message.pairs], dtype=np.int64).reshape(-1, 2)


def _agreements(message: Any) -> NDArray[np.bool_]:
    return np.array([pair.agrees for pair in message.pairs], dtype=bool)


def _distances(name: str) -> Read:
    """Numbers (n,), NaN where one is absent."""
    return lambda message: np.array(
        [getattr(one, name) if one.HasField(name) else np.nan for one in message.distances], dtype=np.float64
    )


def _rows(name: str) -> Read:
    """Points or directions (n, 3)."""
    return lambda message: np.array(
        [vector_of(getattr(one, name)) for one in message.points], dtype=np.float64
    ).reshape(-1, 3)


@dataclass(frozen=True)
class LoopPolicy(Resource):
    """Which loop closures are accepted; None stands for the value of the service.

    `candidates`: submaps that are verified for each new one. A candidate is accepted with a score of at least
    `min_score` and an overlap of at least `min_overlap`, where at most `max_seen_through` of it was looked through.
    """

    candidates: int | None = None
    min_score: float | None = None
    min_overlap: float | None = None
    max_seen_through: float | None = None


@dataclass(frozen=True)
class Map(Resource):
    """A map; `scene_scale` is the size of its scene compared with a street, `loop_policy` has the values in force.

    `map_version` is the version of its poses that answers rest on, 0 before the first. `profile` is the form of the
    method that describes its submaps, product or paper.
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
    profile: str = "product"


@dataclass(frozen=True)
class MapPose:
    """A pose (4, 4) in a frame of the map, by a version of the map; poses of different frames cannot be compared."""

    T_map: Matrix4 = field(compare=False)
    frame: str
    map_version: int


@dataclass(frozen=True)
class Robot(Resource):
    """A robot."""

    name: str
    display_name: str
    created_at_ns: int


@dataclass(frozen=True)
class Finding(Resource):
    """A likely mistake in the scans of a number of submaps: its likely cause, and advice."""

    code: str
    submaps: int
    cause: str
    advice: str


@dataclass(frozen=True)
class NoLoops(Resource):
    """Why a session has no accepted loop: a code, and the same in words, with figures."""

    code: str
    message: str


@dataclass(frozen=True)
class Session(Resource):
    """A session; `committed_seq` is the last scan that is stored durably, 0 for none, taken at `committed_stamp_ns`.

    `findings` are likely mistakes in its scans so far; `no_loops` says why it has no accepted loop, once it
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


@dataclass(frozen=True)
class Operation(Resource):
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
    failure_reason: str | None = field(metadata=read_by(lambda message: message.failure.reason or None))
    failure_message: str | None = field(metadata=read_by(lambda message: message.failure.message or None))
    seq: int | None = field(default=None, compare=False, metadata=read_by(lambda _message: None))
    progress: OperationProgress | None = field(default=None, compare=False)
    cancel_requested: bool = field(default=False, compare=False)

    @property
    def done(self) -> bool:
        """Whether it has ended, well or not."""
        return self.state in ("DONE", "FAILED")


@dataclass(frozen=True)
class OperationProgress(Resource):
    """How far an operation has come: `done` of `total` parts of a stage."""

    stage: str
    done: int
    total: int


@dataclass(frozen=True)
class Submap(Resource):
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
    descriptor: tuple[float, ...] = field(default=(), metadata=read_by(lambda message: tuple(message.place_descriptor)))
    seq: int = 0
    in_map: MapPose | None = field(default=None, compare=False, metadata=read_by(_in_map("t_map_submap")))


@dataclass(frozen=True)
class SearchHit(Resource):
    """A submap and its cosine similarity to the query; `in_map` is T_map_submap where its session has a frame."""

    submap: str
    similarity: float
    position_m: tuple[float, float, float]
    in_map: MapPose | None = field(default=None, compare=False, metadata=read_by(_in_map("t_map_submap")))


@dataclass(frozen=True)
class Candidate(Resource):
    """A submap that was compared with a cloud: accepted with a transform, or rejected for a reason."""

    submap: str
    accepted: bool
    reason: str | None
    similarity: float
    score: float
    T_match_query: Matrix4 | None = field(compare=False)
    evidence: Json


@dataclass(frozen=True)
class Localization(Resource):
    """The best verified candidate, None where the place is unknown, and all that were compared.

    `T_odom_query` (4, 4) is the cloud's pose in the odometry frame of `session`, the session of the best candidate;
    `in_map` is T_map_query where that session has a frame. `on_other_storeys` submaps were not compared, as their
    sessions are on another storey than was said.
    """

    best: Candidate | None
    T_odom_query: Matrix4 | None = field(compare=False)
    session: str | None
    candidates: tuple[Candidate, ...]
    in_map: MapPose | None = field(default=None, compare=False, metadata=read_by(_in_map("t_map_query")))
    on_other_storeys: int = 0


@dataclass(frozen=True)
class LoopClosure(Resource):
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
    in_map: MapPose | None = field(default=None, compare=False, metadata=read_by(_in_map("t_map_query")))
    T_map_match: Matrix4 | None = field(default=None, compare=False)


@dataclass(frozen=True)
class KeypointPlan(Resource):
    """The keypoints (n, 2) of a submap, metres in its upright frame; T_submap_level (4, 4) is where that lies."""

    submap: str
    T_submap_level: Matrix4 = field(compare=False)
    keypoints: NDArray[np.float64] = field(
        compare=False, metadata=read_by(lambda plan: np.stack([plan.x, plan.y], axis=1))
    )


@dataclass(frozen=True)
class LoopKeypoints(Resource):
    """The compared keypoints of a loop closure: both submaps from above.

    pairs (p, 2): rows of the keypoints of query and match that look alike, the most alike first; agrees (p,): whether
    the pose of the loop closure brings them together.
    """

    query: KeypointPlan
    match: KeypointPlan
    pairs: NDArray[np.int64] = field(compare=False, metadata=read_by(_pairs))
    agrees: NDArray[np.bool_] = field(compare=False, metadata=read_by(_agreements))


@dataclass(frozen=True)
class LoopClosureEvent(Resource):
    """A change of a loop closure: its new state, the actor and the reason.

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


@dataclass(frozen=True)
class MapChange(Resource):
    """Something that one day has and the other has not: `kind` VANISHED or APPEARED.

    A box along the axes of the map's frame: centre and extent (3,) in metres, around so many neural `points`.
    """

    kind: str
    centre_m: tuple[float, float, float]
    extent_m: tuple[float, float, float]
    points: int


@dataclass(frozen=True)
class MapMerge(Resource):
    """A merge into a map: `source` was copied as `sessions`, version `version_before` became `version`.

    `report` has alignment and evidence; `changes` are vanished and new things since the map was made;
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


@dataclass(frozen=True)
class MapVersion(Resource):
    """A version of a map's poses. `summary` is its evidence; `restored_from` is None where it was optimised."""

    name: str
    version: int
    in_force: bool
    restored_from: int | None
    content_hash: str
    operation: str | None
    summary: MapVersionSummary
    created_at_ns: int


@dataclass(frozen=True)
class MapTile(Resource):
    """A square of a version of a map, in metres of the frame seen from above; `submaps` may reach into it.

    One that was `made` can be downloaded at once; others are made by a worker then.
    """

    name: str
    frame: str
    min_m: tuple[float, float] = field(metadata=read_by(lambda message: (message.min_x_m, message.min_y_m)))
    max_m: tuple[float, float] = field(metadata=read_by(lambda message: (message.max_x_m, message.max_y_m)))
    submaps: int
    made: bool


@dataclass(frozen=True)
class MapDistances(Resource):
    """Signed distances (n,) of points to the surface of a map, metres, positive in free space, cut at a truncation.

    `nearest_m` (n,) says how far the nearest neural point is. Both are NaN where nothing was seen near.
    """

    map_version: int
    frame: str
    distance_m: NDArray[np.float64] = field(compare=False, metadata=read_by(_distances("distance_m")))
    nearest_m: NDArray[np.float64] = field(compare=False, metadata=read_by(_distances("nearest_m")))


@dataclass(frozen=True)
class MapPoints(Resource):
    """Points (n, 3) of the surface of a map around one, with unit normals (n, 3), the nearest first; `total` in all."""

    map_version: int
    frame: str
    positions: NDArray[np.float64] = field(compare=False, metadata=read_by(_rows("position_m")))
    normals: NDArray[np.float64] = field(compare=False, metadata=read_by(_rows("normal")))
    total: int


@dataclass(frozen=True)
class MapFile(Resource):
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


@dataclass(frozen=True)
class RefusedJoin(Resource):
    """Sessions, by name on both sides, that `loops` would join and their surfaces keep apart.

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


@dataclass(frozen=True)
class MapVersionSummary(Resource):
    """The evidence of a version of a map.

    `frames` counts the groups of sessions that loops join; chi2 is to be compared with `degrees_of_freedom`; changes
    are how far submaps lie from where the version before had them, metres, None where none can be compared;
    `refused_joins` are sessions that surfaces kept apart.
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


@dataclass(frozen=True)
class SubmapPose(Resource):
    """Where a submap lies in a frame of the map; covariance (6, 6) of (x, y, z, rx, ry, rz) in the submap's frame.

    The covariance is NaN where the graph does not tell it.
    """

    submap: str
    T_map_submap: Matrix4 = field(compare=False)
    frame: str
    covariance: Matrix4 = field(compare=False, metadata=read_by(covariance_of))


@dataclass(frozen=True)
class Correction(Resource):
    """Where the odometry frame of a session lies in the map: T_map_odom @ T_odom_sensor is a sensor's pose in the map.

    Poses of the same `frame` are in one map. `covariance` (6, 6) of (x, y, z, rx, ry, rz) in the frame of the last
    submap that the version `map_version` has. `early_loops` is not 0 where loops that came after that version have
    moved the session already: then it is provisional, until the next version.
    """

    session: str
    T_map_odom: Matrix4 = field(compare=False)
    frame: str
    map_version: int
    covariance: Matrix4 = field(compare=False, metadata=read_by(covariance_of))
    created_at_ns: int
    early_loops: int = 0


@dataclass(frozen=True)
class Event(Resource):
    """Something that happened in a map: `kind` LOOP_CLOSURE, OPERATION or MAP_VERSION, with it as it stands by now.

    FORGOTTEN: earlier events were asked for and are no longer kept; list the resources of interest again.
    """

    number: int
    kind: str
    map: str
    loop_closure: LoopClosure | None = None
    operation: Operation | None = None
    map_version: MapVersion | None = None


@dataclass(frozen=True)
class Webhook(Resource):
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
    secret: str = field(default="", compare=False, repr=False, metadata=read_by(lambda _message: ""))


@dataclass(frozen=True)
class WebhookDelivery(Resource):
    """One attempt to deliver events: the HTTP status of the answer, or None and the `error`."""

    first_event: int
    last_event: int
    events: int
    attempt: int
    status: int | None
    error: str | None
    took_ms: int
    at_ns: int


@dataclass(frozen=True)
class Status(Resource):
    """The state of the service."""

    version: str
    model_version: str | None
    queued_jobs: int
    running_jobs: int
    failed_jobs: int
    indexed_submaps: int
    workers: tuple[str, ...] = field(
        metadata=read_by(lambda message: tuple(worker.worker_id for worker in message.workers))
    )
