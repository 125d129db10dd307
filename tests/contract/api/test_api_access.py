"""Who may call what: every route and RPC declares its scopes and keeps to them (rows A01, A03)."""

from __future__ import annotations

from dataclasses import replace

import grpc
import pytest
from fastapi import FastAPI

from revisit.api.calls import CALLS
from revisit.api.scopes import Scope
from revisit.service.calls import catalogue
from revisit.service.grpc import server as grpc_server
from revisit.service.rest.access import allows, every_route, require_declared_scopes, scopes_of
from revisit.service.rest.app import create_app
from tests.support.credentials import a_key, bearer, ended
from tests.support.every_call import PUBLIC_PATHS, rest_calls, rpcs
from tests.support.service_world import memory_world

PATHS = {"map_id": "town", "session_id": "monday", "submap_id": "a", "loop_id": "loop-1", "operation_id": "op-1"}


@pytest.mark.parametrize(("method", "path", "scopes"), list(rest_calls()))
def test_without_a_key_no_route_answers_but_the_public_ones(guarded_http, method, path, scopes):
    answer = guarded_http.request(method, path)
    if path in PUBLIC_PATHS:
        assert (scopes, answer.status_code) == ([], 200)
        return
    assert (answer.status_code, answer.json()["reason"]) == (401, "UNAUTHENTICATED")
    assert answer.headers["www-authenticate"] == "Bearer"


@pytest.mark.parametrize(("service", "method"), list(rpcs()))
def test_without_a_key_no_rpc_answers(guarded_grpc, service, method):
    code, _ = ended(guarded_grpc, method)
    assert code is grpc.StatusCode.UNAUTHENTICATED


def test_the_public_routes_are_these_and_hold_nobodys_data():
    routes = list(every_route(create_app(memory_world().use_cases)))
    assert {route.path for route in routes if not scopes_of_any(route)} == PUBLIC_PATHS | {"/openapi.json"}


def scopes_of_any(route):
    return scopes_of(route) if hasattr(route, "dependencies") else []


@pytest.mark.parametrize(("method", "path", "scopes"), list(rest_calls()))
def test_a_key_with_every_scope_but_the_needed_ones_is_refused(guarded, guarded_http, method, path, scopes):
    if not scopes:
        return
    others = [scope.value for scope in Scope if scope.value not in scopes]
    answer = guarded_http.request(method, path, headers=bearer(a_key(guarded.world, scopes=others)))
    assert (answer.status_code, answer.json()["reason"]) == (403, "PERMISSION_DENIED")
    assert all(scope in answer.json()["detail"] for scope in scopes)


@pytest.mark.parametrize(("service", "method"), list(rpcs()))
def test_a_key_with_every_scope_but_the_needed_ones_is_refused_over_grpc(guarded, guarded_grpc, service, method):
    needed = CALLS[method.name].row.scopes
    key = a_key(guarded.world, scopes=[scope.value for scope in Scope if scope not in needed])
    code, details = ended(guarded_grpc, method, bearer(key).items())
    assert code is grpc.StatusCode.PERMISSION_DENIED
    assert all(scope in details for scope in needed)


def test_both_transports_ask_for_the_scopes_of_the_list_of_calls():
    routes = {route.name: set(scopes_of(route)) for route in every_route(create_app(memory_world().use_cases))
              if hasattr(route, "dependencies")}  # fmt: skip
    of_calls = {call.use: call.row.scopes for call in CALLS.values() if call.row.http}
    assert of_calls.items() <= routes.items()
    assert routes.keys() - of_calls.keys() >= {"append_scan", "version"}
    assert routes["append_scan"] == CALLS["StreamScans"].row.scopes
    assert routes["version"] == CALLS["GetStatus"].row.scopes


def test_a_route_that_declares_no_scope_stops_the_start():
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    app.get("/declared", dependencies=[allows(CALLS["GetMap"])])(lambda: None)
    require_declared_scopes(app)
    app.get("/forgotten")(lambda: None)
    with pytest.raises(RuntimeError, match="/forgotten does not declare"):
        require_declared_scopes(app)


def test_a_route_that_allows_no_scope_stops_the_start():
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    app.get("/empty", dependencies=[allows(without_scopes("GetMap"))])(lambda: None)
    with pytest.raises(RuntimeError, match="/empty does not declare"):
        require_declared_scopes(app)


async def test_an_rpc_without_a_row_stops_the_start(monkeypatch):
    monkeypatch.delitem(CALLS, "GetMap")
    with pytest.raises(RuntimeError, match="MapService/GetMap does not declare"):
        grpc_server.create_server(memory_world().use_cases)


async def test_a_row_that_allows_no_scope_stops_the_start(monkeypatch):
    monkeypatch.setitem(CALLS, "GetMap", without_scopes("GetMap"))
    with pytest.raises(RuntimeError, match="MapService/GetMap does not declare"):
        grpc_server.create_server(memory_world().use_cases)


async def test_a_row_that_no_function_answers_stops_the_start(monkeypatch):
    monkeypatch.delattr(catalogue, "create_map")
    with pytest.raises(RuntimeError, match="no function create_map answers"):
        grpc_server.create_server(memory_world().use_cases)


def without_scopes(name):
    call = CALLS[name]
    return replace(call, row=replace(call.row, scopes=frozenset()))
