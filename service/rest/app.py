"""The HTTP application."""

from __future__ import annotations

from typing import Any, ClassVar

from fastapi import FastAPI

from revisit.service.capacity.call_slots import CallSlots
from revisit.service.capacity.in_flight import Turns
from revisit.service.capacity.limits import LONG_BODIES_AT_A_TIME
from revisit.service.metrics import RequestMetrics
from revisit.service.ports.tracing import NoTracer, Tracer
from revisit.service.rest.access import describe_access, require_declared_scopes
from revisit.service.rest.answers import describe_answers
from revisit.service.rest.errors import PROBLEM_JSON, install_error_handlers
from revisit.service.rest.limits import HttpLimits
from revisit.service.rest.middleware import (
    BodyLimit,
    HostGuard,
    OriginGuard,
    RequestEnvelope,
    RequestSlots,
    RequestTimer,
)
from revisit.service.rest.routes import clouds, downloads, events, messages, page, plans, searches, system
from revisit.service.rest.schemas import Problem
from revisit.service.rest.tracing import RequestTracing
from revisit.service.status import STATUS
from revisit.service.use_cases import UseCases

API_VERSION = "1"

BODIES_AND_FILES = (searches, clouds, downloads, plans, events)
"""Written by hand: bodies that are clouds or pictures, answers that are files or streams."""


class _Application(FastAPI):
    """All of a process have the same routes, and so one OpenAPI document, which the first of them makes."""

    _document: ClassVar[dict[str, Any]] = {}

    def openapi(self) -> dict[str, Any]:
        if not self._document:
            self._document.update(super().openapi())
            _complete(self, self._document)
        return self._document


def create_app(
    use_cases: UseCases,
    limits: HttpLimits = HttpLimits(),
    *,
    hosts: frozenset[str] = frozenset(),
    requests: RequestMetrics | None = None,
    tracer: Tracer = NoTracer(),
    described: bool = True,
) -> FastAPI:
    """The ASGI application over `use_cases`, addressed as localhost, by IP address or by one of `hosts`.

    `described`: it answers with its OpenAPI document. Raises RuntimeError for a route without a declaration of its
    scopes.
    """
    app = _Application(
        title="Revisit",
        version=API_VERSION,
        summary="Loop closure as a service for robot fleets",
        docs_url=None,
        redoc_url=None,
        openapi_url="/openapi.json" if described else None,
        generate_unique_id_function=lambda route: route.name,
    )
    app.state.use_cases = use_cases
    app.state.limits = limits
    app.state.long_bodies = Turns(LONG_BODIES_AT_A_TIME, of_tenant=1)
    app.state.slots = CallSlots(limits.calls)
    # Asked in this order: the page's many files last.
    for module in BODIES_AND_FILES:
        app.include_router(module.router)
    messages.add_routes(app, use_cases)
    app.include_router(system.router)
    app.include_router(page.router)
    require_declared_scopes(app)
    install_error_handlers(app)
    app.add_middleware(BodyLimit, limits=limits)
    app.add_middleware(OriginGuard)
    app.add_middleware(HostGuard, hosts=hosts)
    app.add_middleware(RequestTracing, tracer=tracer)
    app.add_middleware(RequestSlots, limits=limits)
    app.add_middleware(RequestEnvelope)
    if requests is not None:
        app.add_middleware(RequestTimer, requests=requests)
    app.openapi()
    return app


def _complete(app: FastAPI, document: dict[str, Any]) -> None:
    """Add the schemas of answers to the OpenAPI document, and every status of the error table to every operation.

    FastAPI's own 422 is never sent; its schemas go.
    """
    describe_answers(document)
    schemas = document["components"]["schemas"]
    schemas["Problem"] = Problem.model_json_schema()
    schemas.pop("HTTPValidationError", None)
    schemas.pop("ValidationError", None)
    problems = document["components"]["responses"] = _problems()
    references = {status: {"$ref": f"#/components/responses/{status}"} for status in problems}
    for operation in (operation for path in document["paths"].values() for operation in path.values()):
        own = {status: answer for status, answer in operation["responses"].items() if status != "422"}
        operation["responses"] = {**references, **own}
    describe_access(app, document)


def _problems() -> dict[str, dict[str, Any]]:
    reasons: dict[str, list[str]] = {}
    for code, status in sorted(STATUS.items(), key=lambda entry: entry[1].http):
        reasons.setdefault(str(status.http), []).append(code.value)
    content = {PROBLEM_JSON: {"schema": {"$ref": "#/components/schemas/Problem"}}}
    return {status: {"description": ", ".join(names), "content": content} for status, names in reasons.items()}
