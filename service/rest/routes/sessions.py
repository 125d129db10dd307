"""`/v1/maps/{map}/sessions` and their scans."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response

from revisit.service.application.access.callers import Scope
from revisit.service.application.contract import limits
from revisit.service.application.ingest.scans import AppendScan
from revisit.service.rest.access import allows
from revisit.service.rest.answers import Ack, Session, SessionPage, answer, answers, page_answer
from revisit.service.rest.bodies import CLOUD_BODY, describe_json, json_body
from revisit.service.rest.parameters import Cases, Cloud, Id, Paging, PoseOfSensor, SessionOf, StampNs, Tenant
from revisit.service.rest.schemas import IN_DIGITS, CreateSessionRequest, bounds
from revisit.service.wire.answers import of_ack, of_session

router = APIRouter(prefix="/v1/maps/{map_id}/sessions", tags=["sessions"])


@router.post(
    "", **answers(Session, 201), openapi_extra=describe_json(CreateSessionRequest), dependencies=[allows(Scope.INGEST)]
)
async def create_session(
    map_id: Id,
    body: Annotated[CreateSessionRequest, json_body(CreateSessionRequest)],
    cases: Cases,
    tenant: Tenant,
) -> Response:
    """Create a session in a map; idempotent like a map."""
    created = await cases.sessions.create(tenant, body.command(map_id))
    return answer(Session, of_session(created.session), 201, replay=created.replay)


@router.get("", **answers(SessionPage), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def list_sessions(map_id: Id, cases: Cases, tenant: Tenant, paging: Paging) -> Response:
    """List the sessions of a map, oldest first."""
    return await page_answer(SessionPage, "sessions", await cases.sessions.list(tenant, map_id, paging), of_session)


@router.post("/{session_id}:finish", **answers(Session), dependencies=[allows(Scope.INGEST)])
async def finish_session(key: SessionOf, cases: Cases, tenant: Tenant) -> Response:
    """Finish a session: the scans of its last, shorter window become a submap. Again: no effect."""
    return answer(Session, of_session(await cases.sessions.finish(tenant, key)))


@router.get("/{session_id}", **answers(Session), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def get_session(key: SessionOf, cases: Cases, tenant: Tenant) -> Response:
    """Get a session."""
    return answer(Session, of_session(await cases.sessions.get(tenant, key)))


@router.delete("/{session_id}", status_code=204, dependencies=[allows(Scope.ADMIN)])
async def delete_session(key: SessionOf, cases: Cases, tenant: Tenant) -> None:
    """Delete a session with its scans, submaps and their loop closures; its streams end, its jobs are dropped."""
    await cases.sessions.delete(tenant, key)


@router.post(
    "/{session_id}/scans",
    **answers(Ack),
    openapi_extra=CLOUD_BODY,
    tags=["scans"],
    dependencies=[allows(Scope.INGEST)],
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
    return answer(Ack, of_ack(ack), replay=ack.replay)
