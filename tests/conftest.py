"""What every test gets: the log of the service goes to pytest, which shows it where a test fails."""

from __future__ import annotations

import pytest
import structlog


@pytest.fixture(autouse=True)
def _service_log() -> None:
    """Services inside the test process do not write between what a command prints."""
    structlog.configure(logger_factory=structlog.stdlib.LoggerFactory())
