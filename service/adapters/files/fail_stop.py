"""Fail-stop: once a disk has failed to sync, nothing more is acknowledged and the process ends.

After a failed fsync the kernel may mark the pages clean although they never reached the disk, so a second fsync that
succeeds proves nothing: only a restart, which reads what is really there, can tell what was stored.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

import structlog

from revisit.service.application.contract.errors import StorageUncertain

log = structlog.get_logger(__name__)


class FailStop:
    """The switch that all stores of a process share: tripped once, never reset."""

    def __init__(self, stop: Callable[[], None] = lambda: None) -> None:
        """`stop` is called once, in the thread that met the error. It should end the process soon."""
        self._stop = stop
        self._lock = threading.Lock()
        self._tripped = False

    @property
    def tripped(self) -> bool:
        """Whether storage has failed."""
        return self._tripped

    def trip(self, reason: str) -> None:
        """Storage has failed: refuse every later write and end the process."""
        with self._lock:
            first, self._tripped = not self._tripped, True
        if first:
            log.critical("storage_failed", reason=reason)
            self._stop()

    def require_sound(self) -> None:
        """Raises StorageUncertain once storage has failed."""
        if self._tripped:
            raise StorageUncertain("storage has failed and the service is restarting")
