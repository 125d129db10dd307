"""Protobuf messages to what use cases take, and views to protobuf messages."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from google.protobuf.struct_pb2 import Struct

from revisit.core.errors import BadField, BadTransform, EmptyCloud, MalformedBody
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.scan import CloudReport
from revisit.formats import POINTCLOUD2, Encoding, PackedCloud, PointField
from revisit.service.application.catalogue.loops import LoopClosureView, LoopState
from revisit.service.application.catalogue.maps import MapView
from revisit.service.application.catalogue.paging import PageRequest
from revisit.service.application.catalogue.robots import RobotView
from revisit.service.application.catalogue.sessions import SessionView
from revisit.service.application.catalogue.submaps import PostedSubmap, SubmapView
from revisit.service.application.housekeeping.system import ServiceStatus
from revisit.service.application.ingest.clouds import EncodedCloud
from revisit.service.application.query.freshness import DEFAULT_WAIT_S, Freshness
from revisit.service.application.query.operations import OperationFailure, OperationState, OperationView
from revisit.service.application.query.searches import (
    Localization,
    LocalizedCandidate,
    SearchCriteria,
    SearchHit,
    SearchResult,
)
from revisit.service.grpc import names
from revisit.v1 import (
    cloud_pb2,
    geometry_pb2,
    loop_closure_pb2,
    map_pb2,
    operation_pb2,
    robot_pb2,
    session_pb2,
    submap_pb2,
    system_pb2,
)

DEFAULT_PAGE_SIZE = 50
_INT64_MAX = 2**63


def page_request(request: Any) -> PageRequest:
    """Of any List request. Raises BadField."""
    return PageRequest(request.page_size or DEFAULT_PAGE_SIZE, request.page_token)


def seq(value: int) -> int:
    """A scan's number. Raises BadField beyond what can be stored."""
    if not 1 <= value < _INT64_MAX:
        raise BadField("seq counts 1, 2, 3, ... up to 2^63 - 1", field="seq")
    return value


def cloud(message: cloud_pb2.Cloud) -> EncodedCloud:
    """The cloud, still encoded. Raises EmptyCloud where there is none, MalformedBody."""
    match message.WhichOneof("content"):
        case "encoded":
            return EncodedCloud(message.encoded.data, message.encoded.content_type)
        case "packed":
            return EncodedCloud(_packed_bytes(message.packed), POINTCLOUD2)
    raise EmptyCloud("the cloud is missing", field="cloud")


def matrix(message: geometry_pb2.Transform, given: bool, field: str) -> Matrix4:
    """The (4, 4) transform. Raises BadTransform, also where it is not given."""
    if not given:
        raise BadTransform(f"{field} is missing", field=field)
    q, t = message.rotation, message.translation
    return se3.from_quaternion((q.x, q.y, q.z, q.w), (t.x, t.y, t.z))


def criteria(request: loop_closure_pb2.SearchSubmapsRequest) -> SearchCriteria:
    """What hits must satisfy. Raises BadField."""
    return SearchCriteria(
        k=request.k if request.HasField("k") else 20,
        min_similarity=optional(request, "min_similarity"),
        exclude_session=names.session_id_in(request.parent, request.exclude_session, "exclude_session"),
        only_session=names.session_id_in(request.parent, request.only_session, "only_session"),
        min_index_gap=optional(request, "min_index_gap"),
        prior_position_m=position(request),
        radius_m=optional(request, "radius_m"),
    )


def freshness(request: Any) -> Freshness:
    """What the answer must rest on. Raises BadField."""
    given = optional(request, "min_seq_timeout_s")
    return Freshness(request.min_seq, DEFAULT_WAIT_S if given is None else given).validated()


def position(request: Any) -> tuple[float, float, float] | None:
    """The prior position, if given."""
    if not request.HasField("prior_position_m"):
        return None
    prior = request.prior_position_m
    return (prior.x, prior.y, prior.z)


def optional(message: Any, field: str) -> Any:
    """The value of an optional field, None where it is absent."""
    return getattr(message, field) if message.HasField(field) else None


def operation_state(value: int) -> OperationState | None:
    """The state of a filter, None where unspecified. Raises BadField for an unknown number."""
    return None if value == 0 else OperationState(_enum_name(operation_pb2.OperationState, value, "OPERATION_STATE_"))


def loop_state(value: int) -> LoopState | None:
    """The state of a filter, None where unspecified. Raises BadField for an unknown number."""
    return None if value == 0 else LoopState(_enum_name(loop_closure_pb2.LoopState, value, "LOOP_STATE_"))


def vector3(values: Any) -> geometry_pb2.Vector3:
    """Three numbers."""
    x, y, z = (float(value) for value in values)
    return geometry_pb2.Vector3(x=x, y=y, z=z)


def transform(matrix4: Matrix4 | None) -> geometry_pb2.Transform | None:
    """A (4, 4) transform, or None."""
    if matrix4 is None:
        return None
    x, y, z, w = (float(value) for value in se3.to_quaternion(np.asarray(matrix4)))
    rotation = geometry_pb2.Quaternion(x=x, y=y, z=z, w=w)
    return geometry_pb2.Transform(translation=vector3(matrix4[:3, 3]), rotation=rotation)


def map_message(view: MapView) -> map_pb2.Map:
    """A map."""
    return map_pb2.Map(
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


def robot_message(view: RobotView) -> robot_pb2.Robot:
    """A robot."""
    return robot_pb2.Robot(
        name=f"robots/{view.robot_id}", display_name=view.display_name, created_at_ns=view.created_at_ns
    )


def session_message(view: SessionView) -> session_pb2.Session:
    """A session."""
    return session_pb2.Session(
        name=view.key.name,
        robot="" if view.robot_id is None else f"robots/{view.robot_id}",
        state=f"SESSION_STATE_{view.state.value}",
        committed_seq=view.committed_seq,
        travelled_m=view.travelled_m,
        submap_count=view.submap_count,
        created_at_ns=view.created_at_ns,
        finished_at_ns=view.finished_at_ns,
        committed_stamp_ns=view.committed_stamp_ns,
    )


def operation_message(view: OperationView) -> operation_pb2.Operation:
    """An operation."""
    return operation_pb2.Operation(
        name=f"operations/{view.operation_id}",
        kind=f"OPERATION_KIND_{view.kind.value}",
        state=f"OPERATION_STATE_{view.state.value}",
        subject=view.subject,
        attempts=view.attempts,
        result=None if view.result is None else struct_of(view.result),
        failure=_failure(view.failure),
        created_at_ns=view.created_at_ns,
        finished_at_ns=view.finished_at_ns,
    )


def submap_message(view: SubmapView) -> submap_pb2.Submap:
    """A submap."""
    return submap_pb2.Submap(
        name=view.key.name,
        state=f"SUBMAP_STATE_{view.state.value}",
        ordinal=view.ordinal,
        t_odom_submap=transform(view.T_odom_submap),
        position_m=vector3(view.position_m),
        stamp_ns=view.stamp_ns,
        first_seq=view.first_seq,
        last_seq=view.last_seq,
        scan_count=view.scan_count,
        point_count=view.point_count,
        raw_bytes=view.raw_bytes,
        neural_map_bytes=view.neural_map_bytes,
        flags=view.flags,
        model_version=view.model_version or "",
        failure=_failure(view.failure),
        operation=f"operations/{view.operation_id}",
        created_at_ns=view.created_at_ns,
        descriptor=() if view.descriptor is None else view.descriptor.tolist(),
        seq=view.seq,
    )


def posted_message(posted: PostedSubmap) -> submap_pb2.PostSubmapResponse:
    """A durable submap and its operation."""
    return submap_pb2.PostSubmapResponse(
        submap=submap_message(posted.submap),
        operation=operation_message(posted.operation),
        replay=posted.replay,
        report=_report(posted.report),
    )


def loop_message(view: LoopClosureView) -> loop_closure_pb2.LoopClosure:
    """A loop closure with its evidence."""
    return loop_closure_pb2.LoopClosure(
        name=view.name,
        number=view.number,
        query=view.query.name,
        match=view.match.name,
        state=f"LOOP_STATE_{view.state.value}",
        reason=view.reason or "",
        similarity=view.similarity,
        score=view.score,
        t_match_query=transform(view.T_match_query),
        evidence=struct_of(view.evidence),
        created_at_ns=view.created_at_ns,
    )


def search_message(result: SearchResult) -> loop_closure_pb2.SearchSubmapsResponse:
    """Hits, most similar first."""
    return loop_closure_pb2.SearchSubmapsResponse(hits=[_hit(hit) for hit in result.hits], searched=result.searched)


def localize_message(result: Localization) -> loop_closure_pb2.LocalizeResponse:
    """The best verified candidate, if any, and all that were compared."""
    return loop_closure_pb2.LocalizeResponse(
        best=None if result.best is None else _candidate(result.best),
        t_map_query=transform(result.T_odom_query),
        candidates=[_candidate(candidate) for candidate in result.candidates],
    )


def status_message(status: ServiceStatus) -> system_pb2.GetStatusResponse:
    """What the service is doing."""
    workers = [system_pb2.Worker(worker_id=w.worker_id, model_version=w.model_version) for w in status.workers]
    return system_pb2.GetStatusResponse(
        version=status.version,
        model_version=status.model_version or "",
        queued_jobs=status.queued_jobs,
        running_jobs=status.running_jobs,
        failed_jobs=status.failed_jobs,
        indexed_submaps=status.indexed_submaps,
        workers=workers,
    )


def struct_of(values: dict[str, Any]) -> Struct:
    """JSON as protobuf."""
    struct_message = Struct()
    struct_message.update(values)
    return struct_message


def _packed_bytes(message: cloud_pb2.PackedCloud) -> bytes:
    fields = tuple(PointField(f.name, f.offset, f.datatype, f.count) for f in message.fields)
    quantised = message.encoding == cloud_pb2.PACKED_ENCODING_QUANTISED
    encoding = Encoding.QUANTISED if quantised else Encoding.RAW
    if not quantised and message.encoding > cloud_pb2.PACKED_ENCODING_RAW:
        raise BadField("the encoding of the packed cloud is unknown", field="encoding")
    if any(not field.name.isascii() or len(field.name) > 32 for field in fields):
        raise MalformedBody("names of fields are at most 32 ASCII characters")
    packed = PackedCloud(
        fields, message.point_stride, message.width, message.data, message.height, message.big_endian, encoding
    )
    try:
        return packed.to_bytes()
    except struct.error as error:
        raise MalformedBody("a number of the packed cloud's header is out of range") from error


def _enum_name(enum: Any, value: int, prefix: str) -> str:
    try:
        return str(enum.Name(value)).removeprefix(prefix)
    except ValueError as error:
        raise BadField("unknown state", field="state") from error


def _failure(failure: OperationFailure | None) -> operation_pb2.Failure | None:
    return None if failure is None else operation_pb2.Failure(reason=failure.code, message=failure.message)


def _report(report: CloudReport | None) -> cloud_pb2.CloudReport | None:
    if report is None:
        return None
    return cloud_pb2.CloudReport(dropped_nonfinite=report.dropped_nonfinite, degenerate_plane=report.degenerate_plane)


def _hit(hit: SearchHit) -> loop_closure_pb2.SearchHit:
    return loop_closure_pb2.SearchHit(
        submap=hit.submap.name, similarity=hit.similarity, position_m=vector3(hit.position_m)
    )


def _candidate(candidate: LocalizedCandidate) -> loop_closure_pb2.LocalizedCandidate:
    return loop_closure_pb2.LocalizedCandidate(
        submap=candidate.submap.name,
        accepted=candidate.accepted,
        reason=candidate.reason or "",
        similarity=candidate.similarity,
        score=candidate.score,
        t_match_query=transform(candidate.T_match_query),
        evidence=struct_of(candidate.evidence),
    )
