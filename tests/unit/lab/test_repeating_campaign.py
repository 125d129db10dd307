"""Counting pairs in worlds that repeat: sums and the bound of what was not seen."""

from __future__ import annotations

import pytest

from lab.repeating_campaign import Counts, DriveCounts, drives_summary, summary, upper_bound


def test_none_wrong_in_a_thousand_excludes_three_in_a_thousand() -> None:
    assert upper_bound(0, 1_000) == pytest.approx(0.003, rel=0.01)
    assert upper_bound(0, 0) == 1.0
    assert upper_bound(1, 1_000) > upper_bound(0, 1_000)


def test_worlds_are_summed_up_each_and_together() -> None:
    lines = [Counts("garage", 1, 12, 12, 0, 0, 0, 11), Counts("garage", 2, 12, 12, 1, 0, 2, 12)]
    table = summary([*lines, Counts("orchard", 1, 12, 8, 0, 2, 8, 8)])
    assert table[2].startswith("| garage | 24 | 24 | 1 |")
    assert table[-1].startswith("| **all** | 36 | 32 | 1 |")
    assert table[-1].endswith("| 2, 10 | 0.97 |")


def test_pairs_of_two_drives_are_summed_up_alone_and_as_served() -> None:
    lines = [DriveCounts("garage", 1, 36, 1, 2, 0, 5), DriveCounts("orchard", 1, 36, 0, 9, 0, 11)]
    table = drives_summary([*lines, DriveCounts("garage", 2, 36, 0, 1, 0, 4)])
    assert table[0] == "| world | pairs | alone: wrong | right | as served: wrong | right |"
    assert table[2:] == ["| garage | 72 | 1 | 3 | 0 | 9 |", "| orchard | 36 | 0 | 9 | 0 | 11 |",
                         "| **all** | 108 | 1 | 12 | 0 | 20 |"]  # fmt: skip
