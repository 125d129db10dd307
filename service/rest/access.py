"""Authorisation of routes: every route declares its scopes, or the application does not start."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

from fastapi import Depends, FastAPI, Security
from fastapi.params import Security as DeclaredScopes
from fastapi.routing import APIRoute
from fastapi.security import SecurityScopes
from starlette.requests import Request
from starlette.routing import BaseRoute

from revisit.api.calls import Call, Form
from revisit.api.scopes import Scope
from revisit.core.errors import RevisitError
from revisit.service.capacity.call_slots import CallSlots
from revisit.service.domain.callers import enter
from revisit.service.edge import requests
from revisit.service.edge.requests import refusal
from revisit.service.features.keys.admission import STREAM_RECHECK_S, Credential
from revisit.service.rest.door import VOUCH
from revisit.service.rest.event_stream import gone
from revisit.service.rest.paths import path_of
from revisit.service.rest.tracing import PROBES, call_of
from revisit.v1.comments import COMMENTS

SCHEME = "bearer"

FRAMEWORK_PATHS = frozenset({"/openapi.json"})
"""Routes that FastAPI adds by itself: a description of the interface, of nobody's data."""


async def admitted(request: Request, needed: SecurityScopes) -> None:
    """Admit the caller where its credential has one of the scopes `needed`, before anything of the request is read.

    The request holds one of its slots from now on, until it is answered.

    Raises Unauthenticated, PermissionDenied, TooManyFailures, RateLimited.
    """
    scopes = frozenset(Scope(scope) for scope in needed.scopes)
    path = f"{request.method} {request.url.path}"
    access = request.app.state.use_cases.access
    shown = credential_of(request)
    caller = await access.admit_call(shown, scopes, call_of(request.scope), path)
    enter(caller)
    if (voucher := getattr(request.state, VOUCH, None)) is not None:
        voucher.admitted(shown.bearer)
    slots: CallSlots = request.app.state.slots
    held = slots.hold(slots.calls, caller.tenant, caller.name, partial(gone, request.receive))
    request.state.held.enter_context(held)


async def until_refused(request: Request, scopes: frozenset[Scope]) -> RevisitError:
    """Why the caller of an answer that goes on has lost its right to it; returns once it has."""
    access, path = request.app.state.use_cases.access, f"{request.method} {request.url.path}"
    verify = partial(access.admit, credential_of(request), scopes, call_of(request.scope), path)
    return await refusal(verify, STREAM_RECHECK_S)


async def anyone(request: Request) -> None:
    """Declares a route that holds nobody's data. Raises RateLimited, but where health is asked for."""
    if request.url.path not in PROBES:
        await request.app.state.use_cases.access.admit_public(_address_of(request))


def allows(call: Call) -> Any:
    """Declares that a route is for callers with one of the scopes of a call."""
    return Security(admitted, scopes=[scope for scope in Scope if scope in call.row.scopes])


def served(call: Call, *dependencies: Any) -> dict[str, Any]:
    """The arguments of a call's route from its row: path, method, name, description, group, scopes."""
    return {
        "path": path_of(call),
        "methods": [call.row.http.partition(" ")[0]],
        "name": call.use,
        "description": COMMENTS[call.method.full_name] if call.row.form is Form.MESSAGE else None,
        "tags": [call.tag],
        "dependencies": [allows(call), *dependencies],
    }


PUBLIC = Depends(anyone)


def credential_of(request: Request) -> Credential:
    """The credential of a request: headers and the address of the connection. Raises Unauthenticated."""
    return requests.credential_of(request.headers.getlist("authorization"), _address_of(request))


def _address_of(request: Request) -> str:
    return request.client.host if request.client is not None else ""


def require_declared_scopes(app: FastAPI) -> None:
    """Raises RuntimeError for a route without a declaration of its scopes."""
    for route in every_route(app):
        path = getattr(route, "path", None)
        if isinstance(route, APIRoute):
            declared = [d for d in route.dependencies if d.dependency in (admitted, anyone)]
            if len(declared) == 1 and (scopes_of(route) or declared[0].dependency is anyone):
                continue
        elif path in FRAMEWORK_PATHS:
            continue
        raise RuntimeError(f"{path or route} does not declare who may call it")


def every_route(routes: Any) -> Iterator[BaseRoute]:
    """The routes of an application or router, also of the routers that were included in it."""
    for route in routes.routes:
        # Where FastAPI keeps an included router in one piece instead of copying its routes.
        included = getattr(route, "original_router", None)
        if included is None:
            yield route
        else:
            yield from every_route(included)


def scopes_of(route: APIRoute) -> list[str]:
    """The scopes of which a caller needs one; none for a route that is open to all."""
    return [scope for d in route.dependencies if isinstance(d, DeclaredScopes) for scope in d.scopes or ()]


def describe_access(app: FastAPI, document: dict[str, Any]) -> None:
    """Write the scopes of each route into the OpenAPI document."""
    document["components"]["securitySchemes"] = {
        SCHEME: {"type": "http", "scheme": "bearer", "description": "An API key, `rv_...`, or a JWT of your issuer."}
    }
    for route in every_route(app):
        if isinstance(route, APIRoute) and route.include_in_schema:
            for method in route.methods or ():
                operation = document["paths"][route.path_format][method.lower()]
                operation["security"] = [{SCHEME: [scope]} for scope in scopes_of(route)]
