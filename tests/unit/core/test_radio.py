"""Radio fingerprints: how alike two places hear."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.radio import LEAST_HEARD, MOST_HEARD, RadioFingerprint, likeness


def named(*names: int) -> dict[bytes, float]:
    return {bytes([name] * 8): -50.0 for name in names}


def heard(*names: int) -> RadioFingerprint:
    return RadioFingerprint.of([named(*names)])


def test_likeness_is_the_share_of_what_both_hear():
    assert likeness(heard(1, 2, 3, 4), heard(1, 2, 3, 4)) == pytest.approx(1.0)
    assert likeness(heard(1, 2, 3, 4), heard(3, 4, 5, 6)) == pytest.approx(2 / 6)
    assert likeness(heard(1, 2, 3, 4), heard(5, 6, 7, 8)) == 0.0


def test_what_is_heard_weakly_counts_less():
    loud, faint = named(1, 2, 3, 4), dict.fromkeys(named(1, 2, 3, 4), -75.0)
    assert likeness(RadioFingerprint(loud), RadioFingerprint(faint)) == pytest.approx(0.25)  # half the level, squared


def test_a_fingerprint_of_few_access_points_tells_nothing():
    few = heard(*range(LEAST_HEARD - 1))
    assert likeness(few, few) is None and likeness(None, heard(1, 2, 3, 4)) is None


def test_readings_of_a_place_are_averaged_and_the_strongest_kept():
    first, second = named(1, 2), {**named(1), bytes(8): -90.0}
    second[bytes([1] * 8)] = -60.0
    made = RadioFingerprint.of([first, second])
    assert made.heard == {bytes(8): -90.0, bytes([1] * 8): -55.0, bytes([2] * 8): -50.0}
    many = {bytes([1] * 7 + [name]): -50.0 - 0.5 * name for name in range(MOST_HEARD + 10)}
    assert min(RadioFingerprint.of([many]).heard.values()) == -50.0 - 0.5 * (MOST_HEARD - 1)


def test_bytes_hold_a_fingerprint():
    rng = np.random.default_rng(0)
    made = RadioFingerprint.of([{rng.bytes(8): float(rng.integers(-100, 1)) for _ in range(50)}])
    stored = made.to_bytes()
    assert len(stored) == 9 * 50 and RadioFingerprint.of_bytes(stored) == made
    assert RadioFingerprint.of_bytes(RadioFingerprint({}).to_bytes()) == RadioFingerprint({})
