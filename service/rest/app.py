"""The HTTP application."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI

from service.application import UseCases
from service.metrics import RequestMetrics
from service.rest.errors import PROBLEM_JSON, install_error_handlers
from service.rest.limits import HttpLimits
from service.rest.middleware import BodyLimit, HostGuard, OriginGuard, RequestEnvelope, RequestTimer
from service.rest.routes import loops, maps, operations, robots, searches, sessions, submaps, system
from service.rest.schemas import Problem

API_VERSION = "1"

_PROBLEMS: dict[int | str, dict[str, Any]] = {
    status: {"description": text, "content": {PROBLEM_JSON: {"schema": {"$ref": "#/components/schemas/Problem"}}}}
    for status, text in {
        "4XX": "The request cannot be served as it is; nothing was stored",
        "5XX": "The service failed; where retryable, repeat the request with the same ids",
    }.items()
}


def create_app(
    use_cases: UseCases,
    limits: HttpLimits = HttpLimits(),
    *,
    hosts: frozenset[str] = frozenset(),
    requests: RequestMetrics | None = None,
) -> FastAPI:
    """The ASGI application over `use_cases`, addressed as localhost, by IP address or by one of `hosts`."""
    app = FastAPI(
        title="Revisit",
        version=API_VERSION,
        summary="Loop closure as a service for robot fleets",
        docs_url=None,
        redoc_url=None,
        responses=_PROBLEMS,
        generate_unique_id_function=lambda route: route.name,
    )
    app.state.use_cases = use_cases
    app.state.limits = limits
    for module in (maps, robots, searches, submaps, sessions, loops, operations, system):
        app.include_router(module.router)
    install_error_handlers(app)
    app.add_middleware(BodyLimit, limits=limits)
    app.add_middleware(OriginGuard)
    app.add_middleware(HostGuard, hosts=hosts)
    app.add_middleware(RequestEnvelope)
    if requests is not None:
        app.add_middleware(RequestTimer, requests=requests)
    _describe_problems(app)
    return app


def _describe_problems(app: FastAPI) -> None:
    """Add `Problem` to the OpenAPI document and drop FastAPI's own 422, which this service never sends."""
    document = app.openapi()
    schemas = document["components"]["schemas"]
    schemas["Problem"] = Problem.model_json_schema()
    schemas.pop("HTTPValidationError", None)
    schemas.pop("ValidationError", None)
    for path in document["paths"].values():
        for operation in path.values():
            operation["responses"].pop("422", None)
