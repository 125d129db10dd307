"""The submaps that the shipped models are trained on: simulated towns of seeds that nothing else uses.

Real recordings are kept out: most forbid redistribution, also of what is derived from them, and a model that has seen a
recording says nothing about recognising it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np

from revisit.core.config import SubmapConfig
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.evaluation.perturbations import keep_beams, turned
from revisit.evaluation.simulator import SENSORS, StreetGrid, TownPlan, build_city, drive, grid_drive, simulate

TRAINING_SEED = 9_000
WINDOW_SCANS = 7
SCAN_SPACING_M = 1.5
PLACE_SPACING_SCANS = 10
LARGEST_SHIFT_SCANS = 5


def training_places(district: int, config: SubmapConfig, count: int) -> Iterator[list[Submap]]:
    """The first `count` places of a drive through training town `district`, the sensor models in turn.

    Each place is seen three times, under a yaw of its own: with all returns, with few of them, and from up to 7.5 m
    farther on.
    """
    rng = np.random.default_rng([TRAINING_SEED + district, 78])
    recent: deque[Scan] = deque(maxlen=WINDOW_SCANS + LARGEST_SHIFT_SCANS)
    for number, scan in enumerate(islice(training_drive(district), (count + 1) * PLACE_SPACING_SCANS)):
        recent.append(scan)
        if len(recent) == recent.maxlen and number % PLACE_SPACING_SCANS == 0:
            scans, shift = list(recent), int(rng.integers(1, LARGEST_SHIFT_SCANS + 1))
            first = scans[:WINDOW_SCANS]
            views = [first, [_thinned(scan, rng) for scan in first], scans[shift : shift + WINDOW_SCANS]]
            yield [_seen(view, config, rng) for view in views]


def training_drive(district: int) -> Iterator[Scan]:
    """The scans of a drive through training town `district`, SCAN_SPACING_M apart, of one of the sensor models."""
    seed, names = TRAINING_SEED + district, sorted(SENSORS)
    rng = np.random.default_rng([seed, 77])
    plan = TownPlan(
        vacant_lots=rng.uniform(0.05, 0.5), street_tree_spacing=rng.uniform(8, 40),
        garden_trees_per_hectare=rng.uniform(20, 200), relief=rng.uniform(0, 2),
    )  # fmt: skip
    grid = StreetGrid.random(4, 4, seed, block_m=float(rng.uniform(50, 110)))
    world = build_city(grid.streets(), seed, plan)
    trajectory = drive(grid_drive(grid), world.ground, lane_m=1.8, spacing_m=SCAN_SPACING_M, sway_seed=seed)
    for scan in simulate(world, trajectory, SENSORS[names[district % len(names)]], seed):
        yield Scan.validated(scan.points, scan.T_world_sensor, scan.stamp_ns)


def _thinned(scan: Scan, rng: np.random.Generator) -> Scan:
    """`scan` as seen by a sensor of few beams, or with few of its points."""
    points = keep_beams(scan.points, int(rng.choice((12, 16, 24))))
    return replace(scan, points=points[rng.random(len(points)) < rng.choice((0.3, 0.6, 1.0))])


def _seen(scans: list[Scan], config: SubmapConfig, rng: np.random.Generator) -> Submap:
    return turned(Submap.from_window(scans, config).levelled(), float(rng.uniform(-np.pi, np.pi)))
