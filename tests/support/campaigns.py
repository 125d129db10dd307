"""Campaigns: tests that do one thing many times, a few in `make test`, all in a run that may take an hour.

Each takes its size from REVISIT_TEST_<NAME>, ends early once REVISIT_CAMPAIGN_MINUTES are over, and says what it did.
"""

from __future__ import annotations

import os
import secrets
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime

import pytest

from tests.support.figures import append


def sizes(name: str, quick: int, full: int) -> list[object]:
    """Parameters of a test: `quick` for `make test`; as slow, what REVISIT_TEST_<name> says, else `full`."""
    wanted = int(os.environ.get(f"REVISIT_TEST_{name}", str(full)))
    return [pytest.param(quick, id=str(quick)), pytest.param(wanted, id=str(wanted), marks=pytest.mark.slow)]


def seed_of_this_run() -> int:
    """REVISIT_TEST_SEED, else a new one; printed, so that a failure is repeated with it."""
    seed = int(os.environ.get("REVISIT_TEST_SEED", str(secrets.randbelow(10**6))))
    print(f"REVISIT_TEST_SEED={seed}", flush=True)
    return seed


class Campaign:
    """Counts from 1 to `size` or until the time is up; `done` is how many rounds were finished."""

    def __init__(self, promise: str, size: int, now_s: Callable[[], float] = time.monotonic) -> None:
        """`promise` is a row of the promises to clients, P1 to P32."""
        self.done = 0
        self._promise, self._size, self._now_s = promise, size, now_s
        self._began_s = now_s()
        minutes = os.environ.get("REVISIT_CAMPAIGN_MINUTES")
        self._budget_s = 60.0 * float(minutes) if minutes else float("inf")

    @property
    def over(self) -> bool:
        """Whether there is nothing more to do, or no time."""
        return self.left <= 0 or self.seconds >= self._budget_s

    @property
    def left(self) -> int:
        """Rounds that are not done."""
        return self._size - self.done

    @property
    def seconds(self) -> float:
        """Since the campaign began."""
        return self._now_s() - self._began_s

    def __iter__(self) -> Iterator[int]:
        while not self.over:
            yield self.done + 1
            self.done += 1

    def publish(self, figure: str) -> None:
        """State what was found in `done` rounds; to be called behind the last assertion."""
        test = os.environ.get("PYTEST_CURRENT_TEST", "").removesuffix(" (call)")
        append(
            {
                "promise": self._promise,
                "test": test,
                "figure": figure,
                "size": self.done,
                "asked": self._size,
                "seconds": round(self.seconds, 1),
                "date": datetime.now(UTC).date().isoformat(),
            }
        )
