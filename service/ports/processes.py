"""The gateways and search processes that live."""

from __future__ import annotations

from typing import Protocol

from revisit.service.domain.processes import LivingProcess, ProcessRole


class ProcessLog(Protocol):
    """Which processes live, by the store's clock."""

    def announce(self, process: LivingProcess) -> None:
        """The process shows itself."""
        ...

    def alive(self, role: ProcessRole, within_ms: int) -> list[LivingProcess]:
        """Those of a role seen within the last `within_ms` milliseconds, by id."""
        ...

    def forget(self, process_id: str) -> None:
        """The process is gone."""
        ...
