"""A promise about time that is broken is noticed everywhere: as it is written, or in the pace of a busy machine."""

from __future__ import annotations

import pytest

from tests.support import patience
from tests.support.patience import LEEWAY, PATIENCE_S, in_time, slowness


@pytest.fixture
def pace(monkeypatch):
    """Sets how slow the machine is, and whether it is quiet."""

    def set_to(slow: float, quiet: bool = False) -> None:
        monkeypatch.setattr(patience, "QUIET", quiet)
        monkeypatch.setattr(patience, "slowness", lambda: slow)

    return set_to


def test_a_step_that_takes_far_longer_than_promised_is_noticed_beside_other_work(pace):
    pace(1.0)
    assert not in_time(PATIENCE_S, 15.0)


def test_a_slow_machine_may_take_longer_in_its_own_pace(pace):
    pace(3.0)
    assert in_time(3.0 * LEEWAY * 2.0, 2.0) and not in_time(3.1 * LEEWAY * 2.0, 2.0)


def test_a_quiet_machine_is_held_to_the_promise_itself(pace):
    pace(3.0, quiet=True)
    assert in_time(2.0, 2.0) and not in_time(2.1, 2.0)


def test_a_kept_promise_asks_nothing_of_the_machine(monkeypatch):
    monkeypatch.setattr(patience, "slowness", None)
    assert in_time(2.0, 2.0)


def test_no_machine_is_taken_for_a_faster_one():
    assert slowness() >= 1.0
