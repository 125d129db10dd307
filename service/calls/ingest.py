"""Submaps and scans coming in. Streams of scans are answered by `service.grpc.scan_streams`."""

from __future__ import annotations

from revisit.service.calls.catalogue import submap_fields
from revisit.service.calls.operations import operation_fields
from revisit.service.domain.identity import SubmapKey, TenantId
from revisit.service.features.ingest.appending import ScanAck
from revisit.service.features.ingest.posting import PostedSubmap, PostSubmap
from revisit.service.use_cases import UseCases
from revisit.service.wire import names, requests
from revisit.service.wire.fields import Fields, fields_of
from revisit.service.wire.rendering import Answer
from revisit.v1 import ingest_pb2, submap_pb2


async def post_submap(cases: UseCases, tenant: TenantId, request: submap_pb2.PostSubmapRequest) -> Answer:
    """A stored submap, and the operation that describes it."""
    return posted_fields(await cases.posting.post(tenant, submap_to_post(request)))


def submap_to_post(request: submap_pb2.PostSubmapRequest) -> PostSubmap:
    """The submap to store. Raises BadField, BadTransform, EmptyCloud, MalformedBody."""
    session = names.session_key(request.parent, "parent")
    key = SubmapKey(session.map_id, session.session_id, request.submap_id)
    pose = requests.pose(request, "t_odom_submap")
    return PostSubmap(key, pose, request.stamp_ns, requests.cloud(request.cloud))


def posted_fields(posted: PostedSubmap) -> Fields:
    """The fields of a PostSubmapResponse."""
    submap, operation = submap_fields(posted.submap), operation_fields(posted.operation)
    return fields_of(submap_pb2.PostSubmapResponse, posted, submap=submap, operation=operation)


def ack_fields(ack: ScanAck) -> Fields:
    """The fields of an AppendScanResponse."""
    submap = None if ack.submap is None else posted_fields(ack.submap)
    return fields_of(ingest_pb2.AppendScanResponse, ack, submap=submap)
