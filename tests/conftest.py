"""What every test gets: no limit of time that a busy machine could miss, and the log of the service where one fails."""

from __future__ import annotations

import inspect

import httpx
import pytest
import structlog
from hypothesis import HealthCheck, settings

from tests.support.patience import PATIENCE_S

settings.register_profile("steady", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("steady")

_timeout = inspect.signature(httpx.Client).parameters["timeout"].default
"""What every call of httpx that names no limit shares."""
_timeout.connect = _timeout.read = _timeout.write = _timeout.pool = PATIENCE_S


@pytest.fixture(autouse=True)
def _service_log() -> None:
    """Services inside the test process do not write between what a command prints."""
    structlog.configure(logger_factory=structlog.stdlib.LoggerFactory())
