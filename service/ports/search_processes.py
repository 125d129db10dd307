"""The search processes that live."""

from __future__ import annotations

from typing import Protocol

from revisit.service.domain.placement import SearchProcess


class SearchProcessLog(Protocol):
    """Which search processes live. Two that hold a map at once are both right, so a late reader does no harm."""

    def announce(self, process: SearchProcess) -> None:
        """The process shows itself."""
        ...

    def alive(self, within_ms: int) -> list[SearchProcess]:
        """Those seen within the last `within_ms` milliseconds, by id."""
        ...

    def forget(self, process_id: str) -> None:
        """The process is gone."""
        ...
