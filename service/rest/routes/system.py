"""Health, version, status, and the dashboard."""

from __future__ import annotations

from pathlib import Path

from fastapi import APIRouter, Response
from fastapi.responses import FileResponse, JSONResponse

from service.rest.parameters import Cases, Tenant
from service.rest.schemas import Status

WEB = Path(__file__).resolve().parents[2] / "web"

router = APIRouter(tags=["system"])


@router.get("/livez")
async def livez() -> dict[str, str]:
    """The process answers."""
    return {"status": "ok"}


@router.get("/readyz", responses={503: {"description": "Not ready; `reasons` says why"}})
async def readyz(cases: Cases) -> Response:
    """Whether requests can be served."""
    readiness = await cases.system.readiness()
    body = {"ready": readiness.ready, "reasons": list(readiness.reasons)}
    return JSONResponse(body, status_code=200 if readiness.ready else 503)


@router.get("/version")
async def version(cases: Cases, tenant: Tenant) -> dict[str, str | None]:
    """Version of the service and of the models in use."""
    status = await cases.system.status(tenant)
    return {"version": status.version, "model_version": status.model_version}


@router.get("/v1/status")
async def get_status(cases: Cases, tenant: Tenant) -> Status:
    """Queue depth, index size, workers and versions."""
    return Status.of(await cases.system.status(tenant))


@router.get("/", include_in_schema=False)
async def dashboard() -> FileResponse:
    """The dashboard's page."""
    return FileResponse(WEB / "index.html")


@router.get("/dashboard.js", include_in_schema=False)
async def dashboard_script() -> FileResponse:
    """The dashboard's script."""
    return FileResponse(WEB / "dashboard.js", media_type="text/javascript")


@router.get("/dashboard.css", include_in_schema=False)
async def dashboard_style() -> FileResponse:
    """The dashboard's style."""
    return FileResponse(WEB / "dashboard.css", media_type="text/css")
