"""`/v1/maps/{map}/sessions` and their scans."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response

from revisit.service.application.access.callers import Scope
from revisit.service.application.catalogue.sessions import CreateSession
from revisit.service.application.ingest.scans import AppendScan
from revisit.service.rest.access import allows
from revisit.service.rest.bodies import CLOUD_BODY, describe_json, json_body
from revisit.service.rest.parameters import (
    Cases,
    Cloud,
    Id,
    Paging,
    PoseOfSensor,
    SessionOf,
    StampNs,
    Tenant,
    mark_replay,
)
from revisit.service.rest.schemas import Ack, CreateSessionRequest, Session, SessionPage

router = APIRouter(prefix="/v1/maps/{map_id}/sessions", tags=["sessions"])


@router.post(
    "", status_code=201, openapi_extra=describe_json(CreateSessionRequest), dependencies=[allows(Scope.INGEST)]
)
async def create_session(
    map_id: Id,
    body: Annotated[CreateSessionRequest, json_body(CreateSessionRequest)],
    cases: Cases,
    tenant: Tenant,
    response: Response,
) -> Session:
    """Create a session in a map; idempotent like a map."""
    created = await cases.sessions.create(tenant, CreateSession(map_id, body.session_id, body.robot_id))
    mark_replay(response, created.replay)
    return Session.of(created.session)


@router.get("", dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def list_sessions(map_id: Id, cases: Cases, tenant: Tenant, paging: Paging) -> SessionPage:
    """List the sessions of a map, oldest first."""
    page = await cases.sessions.list(tenant, map_id, paging)
    return SessionPage(sessions=[Session.of(view) for view in page.items], next_page_token=page.next_token)


@router.post("/{session_id}:finish", dependencies=[allows(Scope.INGEST)])
async def finish_session(key: SessionOf, cases: Cases, tenant: Tenant) -> Session:
    """Finish a session: the scans of its last, shorter window become a submap. Again: no effect."""
    return Session.of(await cases.sessions.finish(tenant, key))


@router.get("/{session_id}", dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def get_session(key: SessionOf, cases: Cases, tenant: Tenant) -> Session:
    """Get a session."""
    return Session.of(await cases.sessions.get(tenant, key))


@router.delete("/{session_id}", status_code=204, dependencies=[allows(Scope.ADMIN)])
async def delete_session(key: SessionOf, cases: Cases, tenant: Tenant) -> None:
    """Delete a session with its scans, submaps and their loop closures; its streams end, its jobs are dropped."""
    await cases.sessions.delete(tenant, key)


@router.post("/{session_id}/scans", openapi_extra=CLOUD_BODY, tags=["scans"], dependencies=[allows(Scope.INGEST)])
async def append_scan(
    key: SessionOf,
    seq: Annotated[int, Query(ge=1, lt=2**63)],
    stamp_ns: StampNs,
    T_odom_sensor: PoseOfSensor,
    cloud: Cloud,
    cases: Cases,
    tenant: Tenant,
    response: Response,
) -> Ack:
    """Append one scan (for robots without gRPC); durable when answered."""
    ack = await cases.scans.append(tenant, AppendScan(key, seq, stamp_ns, T_odom_sensor, cloud))
    mark_replay(response, ack.replay)
    return Ack.of(ack)
