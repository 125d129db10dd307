"""Ages are told by a wall clock that has gone on for an hour: one that jumps makes nothing old."""

from __future__ import annotations

from dataclasses import dataclass

from revisit.service.features.retention.steady_time import STEADY_MS, SteadyTime

MINUTE_MS = 60_000
YEAR_NS = 365 * 86_400 * 10**9


@dataclass
class TwoClocks:
    """A monotonic clock, and a wall clock that can be set."""

    ms: int = 5
    ahead_ns: int = 10**18

    def monotonic_ms(self):
        return self.ms

    def wall_ns(self):
        return self.ms * 10**6 + self.ahead_ns


def read_every_ten_minutes(clock, steady, minutes):
    read = []
    for _ in range(0, minutes, 10):
        clock.ms += 10 * MINUTE_MS
        read.append(steady.now_ns())
    return read


def test_nothing_is_old_in_the_first_hour_and_the_wall_clock_is_believed_afterwards():
    clock = TwoClocks()
    steady = SteadyTime(clock)
    assert read_every_ten_minutes(clock, steady, 60) == [None] * 6
    assert read_every_ten_minutes(clock, steady, 10) == [clock.wall_ns()]


def test_a_clock_that_jumps_ahead_is_believed_after_an_hour_and_one_that_comes_back_at_once():
    clock = TwoClocks()
    steady = SteadyTime(clock)
    read_every_ten_minutes(clock, steady, 120)
    clock.ahead_ns += 3 * YEAR_NS
    within = read_every_ten_minutes(clock, steady, 60)
    assert max(within) < clock.wall_ns() - 2 * YEAR_NS
    assert read_every_ten_minutes(clock, steady, 20)[-1] == clock.wall_ns()
    clock.ahead_ns -= 3 * YEAR_NS
    assert read_every_ten_minutes(clock, steady, 10) == [clock.wall_ns()]


def test_the_hour_begins_anew_where_nobody_read_for_longer():
    clock = TwoClocks()
    steady = SteadyTime(clock)
    steady.now_ns()
    clock.ms += 3 * STEADY_MS
    assert steady.now_ns() == clock.wall_ns()
