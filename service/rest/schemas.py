"""JSON of requests and answers. Field names and shapes follow `proto/revisit/v1`; requests are strict."""

from __future__ import annotations

from typing import Annotated, Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.scan import CloudReport
from revisit.service.application.catalogue.loops import LoopClosureView
from revisit.service.application.catalogue.maps import MAX_SCENE_SCALE, MIN_SCENE_SCALE, CreateMap, MapView
from revisit.service.application.catalogue.robots import CreateRobot, RobotView
from revisit.service.application.catalogue.sessions import SessionView
from revisit.service.application.catalogue.submaps import PostedSubmap, SubmapView
from revisit.service.application.housekeeping.system import ServiceStatus
from revisit.service.application.ingest.scans import ScanAck
from revisit.service.application.query.freshness import DEFAULT_WAIT_S, MAX_WAIT_S
from revisit.service.application.query.operations import OperationFailure, OperationView
from revisit.service.application.query.searches import Localization, LocalizedCandidate, SearchHit, SearchResult

Id = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$", examples=["yard-3"])]
DisplayName = Annotated[str, Field(max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")]
Coordinate = Annotated[float, Field(ge=-1e9, le=1e9)]
K = Annotated[int, Field(ge=1, le=100)]


class Request(BaseModel):
    """What a client sends: nothing unknown, nothing coerced, nothing infinite."""

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, frozen=True)


class Answer(BaseModel):
    """What a client gets."""

    model_config = ConfigDict(frozen=True)


class CreateMapRequest(Request):
    """A new map; `tau_m`, `stride_m` and `min_index_gap` override the service's configuration where given.

    `scene_scale` is the size of its scene compared with a street, e.g. 0.25 for rooms; it cannot be changed later.
    """

    map_id: Id
    display_name: DisplayName = ""
    tau_m: Annotated[float, Field(gt=0, le=1000)] | None = None
    stride_m: Annotated[float, Field(gt=0, le=1000)] | None = None
    min_index_gap: Annotated[int, Field(ge=0, le=1_000_000)] | None = None
    scene_scale: Annotated[float, Field(ge=MIN_SCENE_SCALE, le=MAX_SCENE_SCALE)] = 1.0

    def command(self) -> CreateMap:
        """What the use case takes."""
        return CreateMap(**self.model_dump())


class CreateRobotRequest(Request):
    """A new robot."""

    robot_id: Id
    display_name: DisplayName = ""

    def command(self) -> CreateRobot:
        """What the use case takes."""
        return CreateRobot(self.robot_id, self.display_name)


class CreateSessionRequest(Request):
    """A new session; `robot_id` names an existing robot."""

    session_id: Id
    robot_id: Id | None = None


class SearchRequest(Request):
    """Search by `submap` (a resource name) or by `descriptor` with its `model_version`; exactly one of the two.

    `min_seq`, the seq of a submap: the answer rests on every submap of the map up to it, or is a 504 (SEQ_NOT_REACHED)
    after `min_seq_timeout_s` seconds. A submap whose description failed is not waited for.
    """

    submap: Annotated[str, Field(max_length=300)] | None = None
    descriptor: Annotated[list[float], Field(min_length=1, max_length=4096)] | None = None
    model_version: Annotated[str, Field(max_length=100)] | None = None
    k: K = 20
    min_similarity: Annotated[float, Field(ge=-1, le=1)] | None = None
    exclude_session: Id | None = None
    only_session: Id | None = None
    min_index_gap: Annotated[int, Field(ge=0, le=1_000_000)] | None = None
    prior_position_m: Annotated[list[Coordinate], Field(min_length=3, max_length=3)] | None = None
    radius_m: Annotated[float, Field(gt=0, le=1e6)] | None = None
    min_seq: Annotated[int, Field(ge=0, lt=2**63)] = 0
    min_seq_timeout_s: Annotated[float, Field(ge=0, le=MAX_WAIT_S)] = DEFAULT_WAIT_S


class Vector3(Answer):
    """Metres."""

    x: float
    y: float
    z: float

    @classmethod
    def of(cls, values: Any) -> Self:
        """From three numbers."""
        x, y, z = (float(value) for value in values)
        return cls(x=x, y=y, z=z)


class Quaternion(Answer):
    """A unit quaternion."""

    x: float
    y: float
    z: float
    w: float


class Transform(Answer):
    """A rigid motion; the field that holds it names its frames."""

    translation: Vector3
    rotation: Quaternion

    @classmethod
    def of(cls, transform: Matrix4) -> Self:
        """From a (4, 4) matrix."""
        x, y, z, w = (float(value) for value in se3.to_quaternion(np.asarray(transform)))
        return cls(translation=Vector3.of(transform[:3, 3]), rotation=Quaternion(x=x, y=y, z=z, w=w))

    @classmethod
    def maybe(cls, transform: Matrix4 | None) -> Self | None:
        """From a (4, 4) matrix, or None."""
        return None if transform is None else cls.of(transform)


class Map(Answer):
    """A map."""

    name: str
    display_name: str
    tau_m: float
    stride_m: float
    min_index_gap: int
    scene_scale: float
    session_count: int
    submap_count: int
    created_at_ns: int

    @classmethod
    def of(cls, view: MapView) -> Self:
        """From a use case's view."""
        return cls(
            name=f"maps/{view.map_id}",
            display_name=view.display_name,
            tau_m=view.tau_m,
            stride_m=view.stride_m,
            min_index_gap=view.min_index_gap,
            scene_scale=view.scene_scale,
            session_count=view.session_count,
            submap_count=view.submap_count,
            created_at_ns=view.created_at_ns,
        )


class Robot(Answer):
    """A robot."""

    name: str
    display_name: str
    created_at_ns: int

    @classmethod
    def of(cls, view: RobotView) -> Self:
        """From a use case's view."""
        return cls(name=f"robots/{view.robot_id}", display_name=view.display_name, created_at_ns=view.created_at_ns)


class Session(Answer):
    """A session; `committed_seq` is the last scan stored durably, 0 for none, taken at `committed_stamp_ns`."""

    name: str
    robot: str | None
    state: str
    committed_seq: int
    travelled_m: float
    submap_count: int
    created_at_ns: int
    finished_at_ns: int | None
    committed_stamp_ns: int | None

    @classmethod
    def of(cls, view: SessionView) -> Self:
        """From a use case's view."""
        return cls(
            name=view.key.name,
            robot=None if view.robot_id is None else f"robots/{view.robot_id}",
            state=view.state.value,
            committed_seq=view.committed_seq,
            travelled_m=view.travelled_m,
            submap_count=view.submap_count,
            created_at_ns=view.created_at_ns,
            finished_at_ns=view.finished_at_ns,
            committed_stamp_ns=view.committed_stamp_ns,
        )


class Failure(Answer):
    """Why work failed: a reason of the error table and a sentence."""

    reason: str
    message: str

    @classmethod
    def maybe(cls, failure: OperationFailure | None) -> Self | None:
        """From a use case's view, or None."""
        return None if failure is None else cls(reason=failure.code, message=failure.message)


class Operation(Answer):
    """An operation; `result` once DONE, `failure` once FAILED."""

    name: str
    kind: str
    state: str
    subject: str
    attempts: int
    result: dict[str, Any] | None
    failure: Failure | None
    created_at_ns: int
    finished_at_ns: int | None

    @classmethod
    def of(cls, view: OperationView) -> Self:
        """From a use case's view."""
        return cls(
            name=f"operations/{view.operation_id}",
            kind=view.kind.value,
            state=view.state.value,
            subject=view.subject,
            attempts=view.attempts,
            result=view.result,
            failure=Failure.maybe(view.failure),
            created_at_ns=view.created_at_ns,
            finished_at_ns=view.finished_at_ns,
        )


class Report(Answer):
    """What validation noticed about a cloud."""

    dropped_nonfinite: int
    degenerate_plane: bool

    @classmethod
    def maybe(cls, report: CloudReport | None) -> Self | None:
        """From the core's report, or None."""
        if report is None:
            return None
        return cls(dropped_nonfinite=report.dropped_nonfinite, degenerate_plane=report.degenerate_plane)


class Submap(Answer):
    """A submap; `descriptor` is empty unless view=FULL was asked for and the submap is described.

    `seq` grows with every submap of the service, in the order in which they were stored: a query's `min_seq`.
    """

    name: str
    seq: int
    state: str
    ordinal: int
    t_odom_submap: Transform
    position_m: Vector3
    stamp_ns: int
    first_seq: int | None
    last_seq: int | None
    scan_count: int
    point_count: int
    raw_bytes: int
    neural_map_bytes: int | None
    flags: list[str]
    model_version: str | None
    failure: Failure | None
    operation: str
    created_at_ns: int
    descriptor: list[float]

    @classmethod
    def of(cls, view: SubmapView) -> Self:
        """From a use case's view."""
        return cls(
            name=view.key.name,
            seq=view.seq,
            state=view.state.value,
            ordinal=view.ordinal,
            t_odom_submap=Transform.of(view.T_odom_submap),
            position_m=Vector3.of(view.position_m),
            stamp_ns=view.stamp_ns,
            first_seq=view.first_seq,
            last_seq=view.last_seq,
            scan_count=view.scan_count,
            point_count=view.point_count,
            raw_bytes=view.raw_bytes,
            neural_map_bytes=view.neural_map_bytes,
            flags=list(view.flags),
            model_version=view.model_version,
            failure=Failure.maybe(view.failure),
            operation=f"operations/{view.operation_id}",
            created_at_ns=view.created_at_ns,
            descriptor=[] if view.descriptor is None else view.descriptor.tolist(),
        )


class Posted(Answer):
    """A durable submap and the operation that describes it; `report` is null on a replay."""

    submap: Submap
    operation: Operation
    replay: bool
    report: Report | None

    @classmethod
    def of(cls, posted: PostedSubmap) -> Self:
        """From a use case's result."""
        return cls(
            submap=Submap.of(posted.submap),
            operation=Operation.of(posted.operation),
            replay=posted.replay,
            report=Report.maybe(posted.report),
        )


class Ack(Answer):
    """The scan is durable; `submap` is the one that it completed."""

    committed_seq: int
    replay: bool
    report: Report | None
    submap: Posted | None

    @classmethod
    def of(cls, ack: ScanAck) -> Self:
        """From a use case's result."""
        return cls(
            committed_seq=ack.committed_seq,
            replay=ack.replay,
            report=Report.maybe(ack.report),
            submap=None if ack.submap is None else Posted.of(ack.submap),
        )


class Hit(Answer):
    """A submap and its cosine similarity to the query."""

    submap: str
    similarity: float
    position_m: Vector3

    @classmethod
    def of(cls, hit: SearchHit) -> Self:
        """From a use case's result."""
        return cls(submap=hit.submap.name, similarity=hit.similarity, position_m=Vector3.of(hit.position_m))


class SearchAnswer(Answer):
    """Hits, most similar first; `searched` is how many submaps the map's index held."""

    hits: list[Hit]
    searched: int

    @classmethod
    def of(cls, result: SearchResult) -> Self:
        """From a use case's result."""
        return cls(hits=[Hit.of(hit) for hit in result.hits], searched=result.searched)


class Candidate(Answer):
    """One submap that was compared with the cloud."""

    submap: str
    accepted: bool
    reason: str | None
    similarity: float
    score: float
    t_match_query: Transform | None
    evidence: dict[str, Any]

    @classmethod
    def of(cls, candidate: LocalizedCandidate) -> Self:
        """From a use case's result."""
        return cls(
            submap=candidate.submap.name,
            accepted=candidate.accepted,
            reason=candidate.reason,
            similarity=candidate.similarity,
            score=candidate.score,
            t_match_query=Transform.maybe(candidate.T_match_query),
            evidence=candidate.evidence,
        )


class LocalizeAnswer(Answer):
    """The best verified candidate, null where the place is unknown, and all that were compared."""

    best: Candidate | None
    t_map_query: Transform | None
    candidates: list[Candidate]

    @classmethod
    def of(cls, result: Localization) -> Self:
        """From a use case's result."""
        return cls(
            best=None if result.best is None else Candidate.of(result.best),
            t_map_query=Transform.maybe(result.T_odom_query),
            candidates=[Candidate.of(candidate) for candidate in result.candidates],
        )


class LoopClosure(Answer):
    """A pair of submaps that look alike, with the verdict and its evidence."""

    name: str
    number: int
    query: str
    match: str
    state: str
    reason: str | None
    similarity: float
    score: float
    t_match_query: Transform | None
    evidence: dict[str, Any]
    created_at_ns: int

    @classmethod
    def of(cls, view: LoopClosureView) -> Self:
        """From a use case's view."""
        return cls(
            name=view.name,
            number=view.number,
            query=view.query.name,
            match=view.match.name,
            state=view.state.value,
            reason=view.reason,
            similarity=view.similarity,
            score=view.score,
            t_match_query=Transform.maybe(view.T_match_query),
            evidence=view.evidence,
            created_at_ns=view.created_at_ns,
        )


class Worker(Answer):
    """A worker process that has shown itself lately."""

    worker_id: str
    model_version: str


class Status(Answer):
    """What the service is doing."""

    version: str
    model_version: str | None
    queued_jobs: int
    running_jobs: int
    failed_jobs: int
    indexed_submaps: int
    workers: list[Worker]

    @classmethod
    def of(cls, status: ServiceStatus) -> Self:
        """From a use case's view."""
        workers = [Worker(worker_id=worker.worker_id, model_version=worker.model_version) for worker in status.workers]
        return cls(
            version=status.version,
            model_version=status.model_version,
            queued_jobs=status.queued_jobs,
            running_jobs=status.running_jobs,
            failed_jobs=status.failed_jobs,
            indexed_submaps=status.indexed_submaps,
            workers=workers,
        )


class MapPage(Answer):
    """A page of maps; `next_page_token` is "" on the last one, here and in every list."""

    maps: list[Map]
    next_page_token: str


class RobotPage(Answer):
    """A page of robots."""

    robots: list[Robot]
    next_page_token: str


class SessionPage(Answer):
    """A page of sessions."""

    sessions: list[Session]
    next_page_token: str


class SubmapPage(Answer):
    """A page of submaps."""

    submaps: list[Submap]
    next_page_token: str


class LoopClosurePage(Answer):
    """A page of loop closures."""

    loop_closures: list[LoopClosure]
    next_page_token: str


class OperationPage(Answer):
    """A page of operations."""

    operations: list[Operation]
    next_page_token: str


class Problem(Answer):
    """RFC 9457 problem details; `reason` is the machine-readable cause, `code` its canonical gRPC code."""

    type: str
    title: str
    status: int
    detail: str
    code: str
    reason: str
    retryable: bool
    request_id: str
    field: str | None = None
    expected_seq: int | None = None
