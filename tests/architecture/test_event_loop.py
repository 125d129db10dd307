"""What a route asks for is found on the event loop: FastAPI sends a plain function to a thread and waits for it."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from typing import Any

from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute

from revisit.service.rest.access import every_route
from revisit.service.rest.app import create_app
from tests.support.service_world import memory_world


def calls_of(dependant: Dependant) -> Iterator[Callable[..., Any]]:
    if dependant.call is not None:
        yield dependant.call
    for dependency in dependant.dependencies:
        yield from calls_of(dependency)


def test_no_route_and_nothing_that_a_route_asks_for_runs_in_a_thread_of_fastapi():
    routes = [route for route in every_route(create_app(memory_world().use_cases)) if isinstance(route, APIRoute)]
    calls = {call for route in routes for call in calls_of(route.dependant)}
    assert len(calls) > len(routes) > 20
    assert [call for call in calls if not inspect.iscoroutinefunction(call)] == []
