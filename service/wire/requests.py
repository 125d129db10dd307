"""Request messages of `proto/revisit/v1` to what the use cases take."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import fields
from typing import Any

import numpy as np

from revisit.core.errors import BadField, BadTransform, EmptyCloud, MalformedBody
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.formats import POINTCLOUD2, Encoding, PackedCloud, PointField
from revisit.service.application import SubmapKey
from revisit.service.application.catalogue.downloads import DownloadKind
from revisit.service.application.catalogue.maps import CreateMap
from revisit.service.application.catalogue.paging import PageRequest
from revisit.service.application.catalogue.sessions import CreateSession
from revisit.service.application.contract import limits
from revisit.service.application.contract.identity import SessionKey
from revisit.service.application.contract.loop_policy import LoopPolicy
from revisit.service.application.contract.states import EventKind, GraphState, LoopState, OperationState
from revisit.service.application.ingest.clouds import EncodedCloud
from revisit.service.application.ingest.scans import AppendScan
from revisit.service.application.ingest.submap_posting import PostSubmap
from revisit.service.application.mapping.loop_decisions import ProposeLoop
from revisit.service.application.mapping.merges import MergeMap
from revisit.service.application.push.webhooks import CreateWebhook
from revisit.service.application.query.freshness import DEFAULT_WAIT_S, Freshness
from revisit.service.application.query.search_answers import SearchCriteria
from revisit.service.application.query.searches import LocalizeQuery
from revisit.service.wire import names
from revisit.v1 import (
    cloud_pb2,
    event_pb2,
    geometry_pb2,
    ingest_pb2,
    loop_closure_pb2,
    map_pb2,
    mapping_pb2,
    operation_pb2,
    session_pb2,
    submap_pb2,
    webhook_pb2,
)

DEFAULT_OPERATION_WAIT_S = 30.0

_DOWNLOADS: dict[int, tuple[DownloadKind, str | None]] = {
    submap_pb2.DownloadSubmapRequest.PCD: (DownloadKind.POINTS, "pcd"),
    submap_pb2.DownloadSubmapRequest.PLY: (DownloadKind.POINTS, "ply"),
    submap_pb2.DownloadSubmapRequest.NPY: (DownloadKind.POINTS, "npy"),
    submap_pb2.DownloadSubmapRequest.MESH: (DownloadKind.MESH, None),
    submap_pb2.DownloadSubmapRequest.GLB: (DownloadKind.MESH, "glb"),
    submap_pb2.DownloadSubmapRequest.NEURAL: (DownloadKind.NEURAL, None),
    submap_pb2.DownloadSubmapRequest.DESCRIPTOR: (DownloadKind.DESCRIPTOR, None),
}


def page(request: Any) -> PageRequest:
    """Of any List request. Raises BadField."""
    return PageRequest(request.page_size or PageRequest().size, request.page_token)


def watch(request: event_pb2.WatchEventsRequest) -> tuple[int | None, frozenset[EventKind]]:
    """Behind which event a watch begins, and what it tells of. Raises BadField for an unknown number of a kind."""
    return _optional(request, "after"), frozenset(_event_kinds(request.kinds))


def create_webhook(request: webhook_pb2.CreateWebhookRequest) -> CreateWebhook:
    """The new webhook. Raises BadField."""
    map_id = names.map_id(request.map, "map") if request.map else None
    return CreateWebhook(request.webhook_id, request.url, map_id, tuple(_event_kinds(request.kinds)))


def _event_kinds(kinds: Iterable[int]) -> list[EventKind]:
    """Raises BadField for an unknown number."""
    return [EventKind(_enum_name(event_pb2.Event.Kind, kind)) for kind in kinds if kind]


def create_map(request: map_pb2.CreateMapRequest) -> CreateMap:
    """The new map; what is absent is as the service is configured."""
    overrides = ("tau_m", "stride_m", "leave_distance_m", "scene_scale")
    given = {field: getattr(request, field) for field in overrides if request.HasField(field)}
    policy = LoopPolicy(**{field.name: _optional(request.loop_policy, field.name) for field in fields(LoopPolicy)})
    return CreateMap(request.map_id, request.display_name, **given, loop_policy=policy)


def create_session(request: session_pb2.CreateSessionRequest) -> CreateSession:
    """The new session. Raises BadField."""
    robot_id = names.robot_id(request.robot, "robot") if request.robot else None
    map_id = names.map_id(request.parent, "parent")
    return CreateSession(map_id, request.session_id, robot_id, request.storey or None)


def post_submap(request: submap_pb2.PostSubmapRequest) -> PostSubmap:
    """The submap to store. Raises BadField, BadTransform, EmptyCloud, MalformedBody."""
    session = names.session_key(request.parent, "parent")
    key = SubmapKey(session.map_id, session.session_id, request.submap_id)
    pose = _pose(request, "t_odom_submap")
    return PostSubmap(key, pose, request.stamp_ns, cloud(request.cloud))


def append_scan(session: SessionKey, scan: ingest_pb2.Scan) -> AppendScan:
    """The scan to append. Raises BadField, BadTransform, EmptyCloud, MalformedBody."""
    return AppendScan(session, scan.seq, scan.stamp_ns, _pose(scan, "t_odom_sensor"), cloud(scan.cloud))


def download(request: submap_pb2.DownloadSubmapRequest) -> tuple[DownloadKind, str | None]:
    """What to download, and the file format where there is a choice. Raises BadField."""
    if request.format not in _DOWNLOADS:
        raise BadField("unknown download format", field="format")
    return _DOWNLOADS[request.format]


def cloud(message: cloud_pb2.Cloud) -> EncodedCloud:
    """The cloud, still encoded. Raises EmptyCloud where there is none, MalformedBody."""
    match message.WhichOneof("content"):
        case "encoded":
            return EncodedCloud(message.encoded.data, message.encoded.content_type)
        case "packed":
            return EncodedCloud(_packed_bytes(message.packed), POINTCLOUD2)
    raise EmptyCloud("the cloud is missing", field="cloud")


def criteria(request: loop_closure_pb2.SearchSubmapsRequest) -> SearchCriteria:
    """What hits must satisfy. Raises BadField."""
    return SearchCriteria(
        k=request.k if request.HasField("k") else SearchCriteria().k,
        min_similarity=_optional(request, "min_similarity"),
        exclude_session=names.session_id_in(request.parent, request.exclude_session, "exclude_session"),
        only_session=names.session_id_in(request.parent, request.only_session, "only_session"),
        leave_distance_m=_optional(request, "leave_distance_m"),
        prior_position_m=_position(request),
        radius_m=_optional(request, "radius_m"),
        storey=request.storey or None,
    )


def localize(request: loop_closure_pb2.LocalizeRequest) -> LocalizeQuery:
    """The cloud and where to look for it. Raises BadField, EmptyCloud, MalformedBody."""
    return LocalizeQuery(
        map_id=names.map_id(request.parent, "parent"),
        cloud=cloud(request.cloud),
        prior_position_m=_position(request),
        radius_m=_optional(request, "radius_m"),
        exclude_session=names.session_id_in(request.parent, request.exclude_session, "exclude_session"),
        only_session=names.session_id_in(request.parent, request.only_session, "only_session"),
        T_level_query=level_pose(request),
        storey=request.storey or None,
        candidates=request.candidates if request.HasField("candidates") else LocalizeQuery.candidates,
    )


def propose_loop(request: loop_closure_pb2.CreateLoopClosureRequest) -> ProposeLoop:
    """The loop that a person has found. Raises BadField, BadTransform."""
    return ProposeLoop(
        query=names.submap_key_in(request.parent, request.query, "query"),
        match=names.submap_key_in(request.parent, request.match, "match"),
        T_match_query=_pose(request, "t_match_query") if request.HasField("t_match_query") else None,
        note=request.note,
    )


def level_pose(request: Any) -> Matrix4 | None:
    """`T_level_query` of a query by cloud, None where there is none. Raises BadTransform."""
    return _pose(request, "t_level_query") if request.HasField("t_level_query") else None


def vector(message: loop_closure_pb2.Descriptor) -> np.ndarray[Any, np.dtype[np.float32]]:
    """The vector (d,) of a descriptor."""
    return np.asarray(message.vector, dtype=np.float32)


def freshness(request: Any) -> Freshness:
    """What the answer must rest on. Raises BadField."""
    given = _optional(request, "min_seq_timeout_s")
    return Freshness(request.min_seq, DEFAULT_WAIT_S if given is None else given)


def merge_map(request: mapping_pb2.MergeMapRequest) -> MergeMap:
    """What is merged into what. Raises BadField, BadTransform."""
    source_map_id, session_id = names.merge_source(request.source)
    near = _pose(request, "t_map_source") if request.HasField("t_map_source") else None
    return MergeMap(
        names.map_id(request.name),
        source_map_id,
        session_id,
        request.validate_only,
        near,
        _optional(request, "radius_m"),
    )


def wait_s(request: operation_pb2.WaitOperationRequest) -> float:
    """How long to wait for an operation, seconds. Raises BadField."""
    given = _optional(request, "timeout_s")
    return DEFAULT_OPERATION_WAIT_S if given is None else limits.WAIT_S.validated(float(given), "timeout_s")


def operation_state(value: int) -> OperationState | None:
    """The state of a filter, None where unspecified. Raises BadField for an unknown number."""
    return None if value == 0 else OperationState(_enum_name(operation_pb2.Operation.State, value))


def loop_state(value: int) -> LoopState | None:
    """The state of a filter, None where unspecified. Raises BadField for an unknown number."""
    return None if value == 0 else LoopState(_enum_name(loop_closure_pb2.LoopClosure.State, value))


def graph_state(value: int) -> GraphState | None:
    """The verdict of the graph in a filter, None where unspecified. Raises BadField for an unknown number."""
    return None if value == 0 else GraphState(_enum_name(loop_closure_pb2.LoopClosure.GraphState, value))


def _optional(message: Any, field: str) -> Any:
    return getattr(message, field) if message.HasField(field) else None


def _position(request: Any) -> tuple[float, float, float] | None:
    prior = _optional(request, "prior_position_m")
    return None if prior is None else (prior.x, prior.y, prior.z)


def _pose(message: Any, field: str) -> Matrix4:
    """The (4, 4) transform in `field`, which errors name `T_...`. Raises BadTransform, also where it is missing."""
    if not message.HasField(field):
        raise BadTransform(f"T{field[1:]} is missing", field=f"T{field[1:]}")
    transform: geometry_pb2.Transform = getattr(message, field)
    q, t = transform.rotation, transform.translation
    return se3.from_quaternion((q.x, q.y, q.z, q.w), (t.x, t.y, t.z))


def _packed_bytes(message: cloud_pb2.PackedCloud) -> bytes:
    point_fields = tuple(PointField(f.name, f.offset, f.datatype, f.count) for f in message.fields)
    quantised = message.encoding == cloud_pb2.PackedCloud.QUANTISED
    encoding = Encoding.QUANTISED if quantised else Encoding.RAW
    if not quantised and message.encoding > cloud_pb2.PackedCloud.RAW:
        raise BadField("the encoding of the packed cloud is unknown", field="encoding")
    if any(not field.name.isascii() or len(field.name) > 32 for field in point_fields):
        raise MalformedBody("names of fields are at most 32 ASCII characters")
    packed = PackedCloud(
        point_fields, message.point_stride, message.width, message.data, message.height, message.big_endian, encoding
    )
    try:
        return packed.to_bytes()
    except struct.error as error:
        raise MalformedBody("a number of the packed cloud's header is out of range") from error


def _enum_name(enum: Any, value: int) -> str:
    try:
        return str(enum.Name(value))
    except ValueError as error:
        raise BadField("unknown state", field="state") from error
