"""The load that each map is to a search process."""

from __future__ import annotations

import threading
from collections import defaultdict

BUSY = 0.6
"""The share of a core that one map may take before a further process holds it, too."""


class MapLoad:
    """CPU seconds by map, since they were last asked for."""

    def __init__(self) -> None:
        """Nothing was asked yet."""
        self._lock = threading.Lock()
        self._cpu_s: dict[int, float] = defaultdict(float)
        self._shares: dict[int, float] = {}

    def note(self, map_number: int, cpu_s: float) -> None:
        """An answer took so long."""
        with self._lock:
            self._cpu_s[map_number] += cpu_s

    def busy(self, within_s: float, settling: float = 0.3) -> frozenset[int]:
        """The maps that took more than `BUSY` of a core of late; `within_s`: seconds since the last call.

        A part `settling` of the average is new each time, so that a burst makes no map move.
        """
        with self._lock:
            noted, self._cpu_s = self._cpu_s, defaultdict(float)
        for number in {*noted, *self._shares}:
            share = noted.get(number, 0.0) / within_s
            self._shares[number] = (1.0 - settling) * self._shares.get(number, 0.0) + settling * share
        self._shares = {number: share for number, share in self._shares.items() if share > BUSY / 100}
        return frozenset(number for number, share in self._shares.items() if share > BUSY)
