"""An event loop whose clock a test sets forward: deadlines come without being waited for, and none comes too early."""

from __future__ import annotations

import asyncio

from tests.support.patience import PATIENCE_S


class ClockedLoop(asyncio.SelectorEventLoop):
    """As asyncio's own; `forward` is called from another thread."""

    _ahead_s = 0.0

    def time(self) -> float:
        """The loop's clock, seconds."""
        return super().time() + self._ahead_s

    def forward(self, seconds: float) -> None:
        """Let so much time pass. What was due by then has run."""
        asyncio.run_coroutine_threadsafe(self._jump(seconds), self).result(PATIENCE_S)

    async def _jump(self, seconds: float) -> None:
        self._ahead_s += seconds
        for _ in range(3):  # timers that are due, and what they call
            await asyncio.sleep(0)
