"""Routes with a cloud to store as body: a scan of a session, a submap."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Query, Response

from revisit.api.calls import CALLS
from revisit.service.calls.ingest import ack_fields, posted_fields
from revisit.service.domain import limits
from revisit.service.domain.identity import SubmapKey
from revisit.service.features.ingest.calls import AppendScan
from revisit.service.features.ingest.posting import PostSubmap
from revisit.service.rest.access import allows, served
from revisit.service.rest.answers import answer, answers
from revisit.service.rest.bodies import CLOUD_BODY
from revisit.service.rest.parameters import Cases, Cloud, PoseOfSensor, PoseOfSubmap, SessionOf, StampNs, Tenant
from revisit.service.rest.schemas import IN_DIGITS, bounds
from revisit.v1 import ingest_pb2, submap_pb2

router = APIRouter()


@router.post(
    "/v1/maps/{map_id}/sessions/{session_id}/scans",
    **answers(ingest_pb2.AppendScanResponse),
    openapi_extra=CLOUD_BODY,
    tags=["sessions", "scans"],
    dependencies=[allows(CALLS["StreamScans"])],
)
async def append_scan(
    key: SessionOf,
    seq: Annotated[int, Query(**bounds(limits.SCAN_SEQ)), IN_DIGITS],
    stamp_ns: StampNs,
    T_odom_sensor: PoseOfSensor,
    cloud: Cloud,
    cases: Cases,
    tenant: Tenant,
) -> Response:
    """Append one scan (for robots without gRPC); durable when answered."""
    ack = await cases.scans.append(tenant, AppendScan(key, seq, stamp_ns, T_odom_sensor, cloud))
    return answer(ingest_pb2.AppendScanResponse, ack_fields(ack), replay=ack.replay)


async def _job_admitted(cases: Cases, tenant: Tenant) -> None:
    """Before the body is read."""
    await cases.admission.precheck_job(tenant)


@router.api_route(
    **served(CALLS["PostSubmap"], Depends(_job_admitted)),
    **answers(submap_pb2.PostSubmapResponse, 202),
    openapi_extra=CLOUD_BODY,
)
async def post_submap(
    key: SessionOf,
    submap_id: Annotated[str, Query(max_length=limits.ID_CHARACTERS)],
    stamp_ns: StampNs,
    T_odom_submap: PoseOfSubmap,
    cloud: Cloud,
    cases: Cases,
    tenant: Tenant,
) -> Response:
    """Store a submap durably and queue its description; wait for the operation of the answer."""
    command = PostSubmap(SubmapKey(key.map_id, key.session_id, submap_id), T_odom_submap, stamp_ns, cloud)
    posted = await cases.posting.post(tenant, command)
    return answer(submap_pb2.PostSubmapResponse, posted_fields(posted), 202, replay=posted.replay)
