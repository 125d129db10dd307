"""The time by which retention tells ages: a wall clock that was set wrongly for a while makes nothing old."""

from __future__ import annotations

from collections import deque

from revisit.service.ports.clock import Clock

STEADY_MS = 3_600_000
"""How long a wall clock must have gone on as the monotonic one before its time is believed."""


class SteadyTime:
    """The earliest time that the wall clock and the readings of the last hour, carried on, agree on."""

    def __init__(self, clock: Clock) -> None:
        """Believes nothing before an hour of readings."""
        self._clock = clock
        self._readings: deque[tuple[int, int]] = deque()

    def now_ns(self) -> int | None:
        """Nanoseconds since 1970, to be asked every few minutes; None until the clock was read for an hour."""
        monotonic_ms, wall_ns = self._clock.monotonic_ms(), self._clock.wall_ns()
        self._readings.append((monotonic_ms, wall_ns))
        while len(self._readings) > 1 and self._readings[1][0] <= monotonic_ms - STEADY_MS:
            self._readings.popleft()
        if self._readings[0][0] > monotonic_ms - STEADY_MS:
            return None
        return min(read_ns + (monotonic_ms - read_ms) * 1_000_000 for read_ms, read_ns in self._readings)
