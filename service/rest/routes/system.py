"""Health and version."""

from __future__ import annotations

from fastapi import APIRouter, Response
from fastapi.responses import JSONResponse

from revisit.api.calls import CALLS
from revisit.service.rest.access import PUBLIC, allows
from revisit.service.rest.parameters import Cases, Tenant

router = APIRouter(tags=["system"])


@router.get("/livez", dependencies=[PUBLIC])
async def livez() -> dict[str, str]:
    """The process answers."""
    return {"status": "ok"}


@router.get("/readyz", responses={503: {"description": "Not ready; `reasons` says why"}}, dependencies=[PUBLIC])
async def readyz(cases: Cases) -> Response:
    """Whether requests can be served, and in `degraded`, which of them are refused nevertheless."""
    readiness = await cases.system.readiness()
    body = {"ready": readiness.ready, "reasons": list(readiness.reasons), "degraded": list(readiness.degraded)}
    return JSONResponse(body, status_code=200 if readiness.ready else 503)


@router.get("/version", dependencies=[allows(CALLS["GetStatus"])])
async def version(cases: Cases, tenant: Tenant) -> dict[str, str | None]:
    """Version of the service and of the models in use."""
    status = await cases.system.status(tenant)
    return {"version": status.version, "model_version": status.model_version}
