"""The simulated drives that recognition is judged on: other towns than those used for training and tuning.

Seeds: 8000 to 8099 are for these drives only; training uses 9000 and above, development 501 to 599.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path as Folder

import numpy as np

from lab.worlds.changes import changed
from revisit.core.geometry import se3
from revisit.core.scan import Points
from revisit.evaluation.datasets import KittiRecording, write_kitti
from revisit.evaluation.simulator import (
    HDL32,
    HDL64,
    OS1_64,
    VLP16,
    LidarModel,
    Path,
    StreetGrid,
    TownPlan,
    World,
    build_city,
    drive,
    simulate,
)
from revisit.evaluation.simulator.lidar import SimulatedScan

TEST_SEEDS = range(8_000, 8_100)
LANE_WAVE_M = 540.0
CLEAR_LANE_M = 1.9
"""Beyond this distance from the middle of the street parked cars stand in the way and must be left out."""

Crossings = tuple[tuple[int, int], ...]
Progress = Callable[[str, int, int], None]

# All cross 4 x 4 streets. MIXED meets itself in the same direction, in reverse and across.
MIXED: Crossings = (
    (0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1), (0, 0), (1, 0), (2, 0), (3, 0), (3, 1), (3, 2), (2, 2), (1, 2),
    (1, 1), (1, 0), (0, 0), (0, 1), (1, 1), (2, 1), (2, 2), (2, 3), (3, 3), (3, 2), (3, 1), (2, 1), (1, 1), (0, 1),
)  # fmt: skip
# All streets one way, then all streets the other way: every crossing is met at right angles.
ACROSS: Crossings = (
    (0, 0), (3, 0), (3, 1), (0, 1), (0, 2), (3, 2), (3, 3), (0, 3), (0, 0), (1, 0), (1, 3), (2, 3), (2, 0),
)  # fmt: skip
_OUT: Crossings = ((0, 0), (3, 0), (3, 1), (0, 1), (0, 2), (3, 2))
THERE_AND_BACK: Crossings = (*_OUT, (3, 3), (0, 3), (3, 3), *_OUT[::-1])
_LAP: Crossings = ((0, 0), (3, 0), (3, 3), (0, 3))
TWO_LAPS: Crossings = (*_LAP, *_LAP, (0, 0), (1, 0))


@dataclass(frozen=True)
class SimulatedDrive:
    """One drive through one town.

    `lanes_m` are the least and greatest distance to the right of the middle of the street, between which the car
    wanders; `later` is the seed of the long-term changes, None for the town as it was built; lengths in metres.
    """

    name: str
    seed: int
    sensor: LidarModel
    route: Crossings
    plan: TownPlan = field(default_factory=TownPlan)
    block_m: float = 90.0
    lanes_m: tuple[float, float] = (1.6, 1.8)
    spacing_m: float = 1.5
    later: int | None = None

    @property
    def scene_scale(self) -> float:
        """They are streets."""
        return 1.0

    def path(self) -> Path:
        """Where the car drives, its lane included."""
        way = self._grid().route(list(self.route)).rounded(6.0).sampled(0.5)
        middle, half = np.mean(self.lanes_m), np.ptp(self.lanes_m) / 2
        lane = middle + half * np.sin(2 * np.pi * way.arc / LANE_WAVE_M)
        return Path.through(way.beside(way.arc, -lane)).rounded(2.0)

    def recorded(self, folder: Folder, progress: Progress | None = None) -> KittiRecording:
        """The drive in KITTI layout under `folder`: simulated if it is not there, with the same parameters, already."""
        target, parameters = folder / self.name, json.dumps(dataclasses.asdict(self), sort_keys=True)
        stamp = target / "simulated.json"
        if not stamp.exists() or stamp.read_text() != parameters:
            self._simulate(target, progress)
            stamp.write_text(parameters)
        return KittiRecording(target)

    def _grid(self) -> StreetGrid:
        return StreetGrid.random(4, 4, self.seed, self.block_m)

    def _world(self) -> World:
        wide = self.lanes_m[1] > CLEAR_LANE_M
        world = build_city(self._grid().streets(), self.seed, self.plan, self.path() if wide else None)
        return world if self.later is None else changed(world, self.later)

    def _recorded(self, index: int, scan: SimulatedScan) -> tuple[Points, se3.Matrix4, int]:
        """Points, pose and time of a scan as they are written: exact."""
        return scan.points, scan.T_world_sensor, scan.stamp_ns

    def _simulate(self, target: Folder, progress: Progress | None) -> None:
        world, start_s = self._world(), 0.0 if self.later is None else 86_400.0
        trajectory = drive(
            self.path(), world.ground, spacing_m=self.spacing_m, start_s=start_s, sway_seed=self.seed + bool(self.later)
        )
        scans = enumerate(simulate(world, trajectory, self.sensor, self.seed + 50 * bool(self.later)))
        report = progress or (lambda *_: None)
        for old in (target / "velodyne").glob("*.bin"):
            old.unlink()
        write_kitti(
            target,
            (
                self._recorded(index, scan)
                for index, scan in scans
                if report(f"simulate {self.name}", index + 1, len(trajectory)) is None
            ),
        )


def _columns(sensor: LidarModel, columns: int) -> LidarModel:
    """The sensor with fewer shots a turn: the drives of several kilometres must fit on a disk."""
    return dataclasses.replace(sensor, columns=columns)


SUBURB = TownPlan(vacant_lots=0.15, garden_trees_per_hectare=80.0)
CENTRE = TownPlan(vacant_lots=0.05, garden_trees_per_hectare=25.0, street_tree_spacing=25.0, moving_cars_per_km=10.0)
GARDENS = TownPlan(vacant_lots=0.35, garden_trees_per_hectare=170.0, street_tree_spacing=9.0)
ESTATE = TownPlan(vacant_lots=0.45, garden_trees_per_hectare=50.0, relief=1.8)
AVENUE = TownPlan(vacant_lots=0.2, street_tree_spacing=11.0, parked_share=0.8)

DRIVES: tuple[SimulatedDrive, ...] = (
    SimulatedDrive("suburb-hdl64", 8_001, _columns(HDL64, 1000), MIXED, SUBURB),
    SimulatedDrive("centre-os1", 8_002, OS1_64, ACROSS, CENTRE),
    SimulatedDrive("gardens-vlp16", 8_003, VLP16, MIXED, GARDENS),
    SimulatedDrive("estate-hdl32", 8_004, _columns(HDL32, 1200), THERE_AND_BACK, ESTATE),
    SimulatedDrive("avenue-os1", 8_005, OS1_64, TWO_LAPS, AVENUE, 100.0, (0.2, 2.8)),
)
"""Single drives: same direction, reverse, crossing and, on the avenue, up to 2.6 m of lateral offset."""

_BEFORE = SimulatedDrive("year-1-hdl64", 8_006, _columns(HDL64, 1000), ACROSS, SUBURB)
SESSIONS: tuple[tuple[SimulatedDrive, SimulatedDrive], ...] = (
    (_BEFORE, dataclasses.replace(_BEFORE, name="year-2-hdl64", route=MIXED, later=8_056)),
)
"""(map, query): the same town a year later, driven on another route."""
