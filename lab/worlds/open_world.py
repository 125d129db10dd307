"""The world of every domain: structure, the ground to drive on, and parking spots."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from revisit.evaluation.simulator.blocks import Blocks, Floats, Material, block, joined
from revisit.evaluation.simulator.structure import Solids, Structure
from revisit.evaluation.simulator.trajectories import Terrain

_SHARE_PARKED = 0.6

CAR = joined(
    [
        block((0.0, 0.0, 0.25), (4.3, 1.8, 0.8), Material.METAL),
        block((-0.2, 0.0, 1.05), (2.4, 1.6, 0.6), Material.GLASS, (0.7, 0.85)),
    ]
)


@dataclass(frozen=True)
class OpenWorld(Structure):
    """A structure, the ground, and `slots` (s, 4): x, y, z, yaw of parked cars."""

    ground: Terrain
    slots: Floats = field(default_factory=lambda: np.zeros((0, 4)))

    def parked(self, seed: int) -> Blocks:
        """The cars that stand there on the day `seed`: other slots are taken on another day."""
        taken = np.random.default_rng([seed, 17]).random(len(self.slots)) < _SHARE_PARKED
        return joined([CAR.placed(slot[:3], float(slot[3])) for slot in self.slots[taken]])


@dataclass
class OpenSolids(Solids):
    """Solids with parking slots x, y, z, yaw."""

    slots: list[tuple[float, float, float, float]] = field(default_factory=list)

    def finished(self, ground: Terrain) -> OpenWorld:
        """The world."""
        built = self.built()
        return OpenWorld(built.triangles, built.materials, ground, np.array(self.slots).reshape(-1, 4))
