"""Heartbeat of a command: a line where it has shown nothing for a while."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Self

AFTER_S = 1.5
POLL_S = 0.25


class Heartbeat:
    """Shows, once each, work that takes longer than `after_s`; nothing while a bar has a stage that goes on."""

    def __init__(
        self, doing: str, tell: Callable[[str], None], *, after_s: float = AFTER_S, look_s: float = POLL_S
    ) -> None:
        """`doing` is the first piece of work; each line is given to `tell`, in a thread of its own."""
        self._tell = tell
        self._after_s = after_s
        self._look_s = look_s
        self._bars: list[Callable[[], bool]] = []
        self._ended = threading.Event()
        self.doing(doing)

    def doing(self, doing: str) -> None:
        """Another piece of work begins."""
        self._doing, self._since, self._shown = doing, time.monotonic(), False

    @contextmanager
    def shown(self, goes_on: Callable[[], bool] = lambda: True) -> Iterator[None]:
        """Something else shows meanwhile how far the work is, as long as it `goes_on`."""
        self._bars.append(goes_on)
        try:
            yield
        finally:
            self._bars.remove(goes_on)
            self._since = time.monotonic()

    def end(self) -> None:
        """Tell nothing any more."""
        self._ended.set()

    def is_due(self) -> bool:
        """Whether a line is to be told now."""
        if any(goes_on() for goes_on in tuple(self._bars)):
            self._since, self._shown = time.monotonic(), False
            return False
        return not self._shown and time.monotonic() >= self._since + self._after_s

    def _watch(self) -> None:
        while not self._ended.wait(self._look_s):
            if self.is_due():
                self._shown = True
                self._tell(self._doing)

    def __enter__(self) -> Self:
        """Begin to watch."""
        self._since = time.monotonic()
        threading.Thread(target=self._watch, name="heartbeat", daemon=True).start()
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        """See `end`."""
        self.end()
