"""What the comparison of simulated with recorded scans counts."""

from __future__ import annotations

import numpy as np

from lab.realism import scan_statistics, table
from revisit.core.scan import Scan


def a_scan(points: np.ndarray) -> Scan:
    return Scan.validated(points.astype(np.float32), np.eye(4), 0)


def grid(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.stack(np.meshgrid(first, second), axis=-1).reshape(-1, 2)


def test_a_floor_is_level_a_wall_steep_and_a_bush_scatter() -> None:
    rng = np.random.default_rng(0)
    flat = grid(np.arange(3, 8, 0.1), np.arange(-2, 2, 0.1)) + 0.05
    floor = np.insert(flat, 2, -1.45, axis=1)
    wall = np.insert(flat, 0, 9.05, axis=1)
    bush = rng.uniform(-1, 1, (4000, 3)) + (-5, 0, 0)
    for points, kind in ((floor, "level plane"), (wall, "steep plane"), (bush, "scatter")):
        found = scan_statistics(a_scan(points), rng)
        assert found[kind] > 90.0, kind


def test_ranges_are_shares_of_all_returns() -> None:
    points = np.concatenate([np.full((30, 3), (3.0, 0, 0)), np.full((70, 3), (0, 30.0, 0))])
    found = scan_statistics(
        a_scan(points + np.random.default_rng(1).normal(0, 0.2, points.shape)), np.random.default_rng(0)
    )
    assert (found["0 to 5 m"], found["20 to 40 m"], found["returns a scan"]) == (30.0, 70.0, 100.0)


def test_the_table_has_a_column_a_recording() -> None:
    assert table({"real": {"scatter": 12.34}, "simulated": {"scatter": 5.0}}).splitlines() == [
        "| | real | simulated |", "|---|---|---|", "| scatter | 12.3 | 5 |"
    ]  # fmt: skip
