"""Every route and RPC of the service, whether a test knows of it or not."""

from __future__ import annotations

import re

import pytest

from revisit.api.calls import CALLS
from revisit.service.rest.app import create_app
from revisit.service.rest.routes.page import WEB
from tests.support.service_world import memory_world

PUBLIC_PATHS = {"/livez", "/readyz", "/", "/docs", "/try"} | {
    f"/{file.relative_to(WEB).as_posix()}" for file in WEB.rglob("*") if file.suffix in (".css", ".js", ".svg")
}


def rest_calls():
    """Every call of the OpenAPI document: method, path with ids filled in, and the scopes of which it needs one."""
    app = create_app(memory_world().use_cases)
    for path, methods in app.openapi()["paths"].items():
        for method, call in methods.items():
            scopes = [scope for way in call.get("security", ()) for scope in way["bearer"]]
            yield pytest.param(method, re.sub(r"{\w+}", "x1", path), scopes, id=f"{method} {path}")


def rpcs():
    """Every RPC of the proto descriptors."""
    for call in CALLS.values():
        service = call.method.containing_service
        yield pytest.param(service.full_name, call.method, id=f"{service.name}.{call.name}")
