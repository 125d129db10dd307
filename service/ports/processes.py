"""The gateways and search processes that live."""

from __future__ import annotations

from typing import Protocol

from revisit.service.domain.processes import LivingProcess, ProcessRole

GONE_AFTER_MS = 8_000
"""A process that did not show itself for so long is gone; where it comes back, it has come anew."""


class ProcessLog(Protocol):
    """Which processes live, by the store's clock, in the order of their coming.

    Workers are told of by `WorkerLog`: by when they were seen last, and also those that are silent but hold leases.
    """

    def announce(self, process: LivingProcess) -> None:
        """The process shows itself."""
        ...

    def alive(self, role: ProcessRole, within_ms: int) -> list[LivingProcess]:
        """Those of a role seen within the last `within_ms` milliseconds, those that came first before others."""
        ...

    def forget(self, process_id: str) -> None:
        """The process is gone."""
        ...
