"""When a worker gives free memory back: pages that are faulted in again cost CPU (docs/decisions/0289)."""

from __future__ import annotations

from revisit.service.large_blocks import return_free_memory
from revisit.service.worker.confinement import resident_bytes

GROWN_BYTES = 64 * 2**20
"""A job that leaves so much more than was held after the last return is followed by another one."""

IDLE_S = 2.0
"""A worker that has waited so long for a job returns its free memory."""


class FreeMemory:
    """Free memory of this process, given back when it has grown, or nothing is to do."""

    def __init__(self) -> None:
        """Nothing has been given back yet."""
        self._held_bytes = 0
        self._waited_s = IDLE_S

    def after_job(self) -> None:
        """A job has ended."""
        self._waited_s = 0.0
        if resident_bytes() - self._held_bytes >= GROWN_BYTES:
            self._give_back()

    def after_waiting(self, seconds: float) -> None:
        """No job came for so long; called again and again."""
        before, self._waited_s = self._waited_s, self._waited_s + seconds
        if before < IDLE_S <= self._waited_s:
            self._give_back()

    def _give_back(self) -> None:
        return_free_memory()
        self._held_bytes = resident_bytes()
