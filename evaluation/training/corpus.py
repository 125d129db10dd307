"""The submaps that the shipped models are trained on: simulated towns of seeds that nothing else uses.

Real recordings are kept out: most forbid redistribution, also of what is derived from them, and a model that has seen a
recording says nothing about recognising it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from core import se3
from core.config import SubmapConfig
from core.scan import Scan
from core.submap import Submap, SubmapBuilder
from evaluation.simulator import SENSORS, StreetGrid, TownPlan, build_city, drive, grid_drive, simulate

TRAINING_SEED = 9_000


def district_submaps(district: int, config: SubmapConfig, count: int) -> Iterator[Submap]:
    """The first `count` submaps of a levelled drive through training town `district`, the sensor models in turn."""
    seed = TRAINING_SEED + district
    names = sorted(SENSORS)
    sensor = SENSORS[names[district % len(names)]]
    rng = np.random.default_rng([seed, 77])
    plan = TownPlan(
        vacant_lots=rng.uniform(0.05, 0.5), street_tree_spacing=rng.uniform(8, 40),
        garden_trees_per_hectare=rng.uniform(20, 200), relief=rng.uniform(0, 2),
    )  # fmt: skip
    grid = StreetGrid.random(4, 4, seed, block_m=float(rng.uniform(50, 110)))
    world = build_city(grid.streets(), seed, plan)
    trajectory = drive(grid_drive(grid), world.ground, lane_m=1.8, spacing_m=1.5, sway_seed=seed)
    builder, taken = SubmapBuilder(config), 0
    for scan in simulate(world, trajectory, sensor, seed):
        finished = builder.add(Scan.validated(scan.points, se3.validated(scan.T_world_sensor), scan.stamp_ns))
        if finished is not None:
            yield Submap.from_scans(finished, config).levelled()
            taken += 1
        if taken == count:
            return
