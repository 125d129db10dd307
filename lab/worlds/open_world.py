"""The world of every domain: triangles with materials, the ground to drive on, and parking spots."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from revisit.evaluation.simulator.blocks import Blocks, Floats, Material, block, joined
from revisit.evaluation.simulator.trajectories import Terrain

_SHARE_PARKED = 0.6

CAR = joined(
    [
        block((0.0, 0.0, 0.25), (4.3, 1.8, 0.8), Material.METAL),
        block((-0.2, 0.0, 1.05), (2.4, 1.6, 0.6), Material.GLASS, (0.7, 0.85)),
    ]
)


@dataclass(frozen=True)
class OpenWorld:
    """Triangles (t, 3, 3), their materials (t,), the ground, and `slots` (s, 4): x, y, z, yaw of parked cars."""

    triangles: NDArray[np.float32]
    materials: NDArray[np.uint8]
    ground: Terrain
    slots: Floats = field(default_factory=lambda: np.zeros((0, 4)))

    def parked(self, seed: int) -> Blocks:
        """The cars that stand there on the day `seed`: other slots are taken on another day."""
        taken = np.random.default_rng([seed, 17]).random(len(self.slots)) < _SHARE_PARKED
        return joined([CAR.placed(slot[:3], float(slot[3])) for slot in self.slots[taken]])


@dataclass
class Solids:
    """Blocks and loose triangles while a world is being built."""

    blocks: list[Blocks] = field(default_factory=list)
    triangles: list[NDArray[np.float32]] = field(default_factory=list)
    materials: list[NDArray[np.uint8]] = field(default_factory=list)
    slots: list[tuple[float, float, float, float]] = field(default_factory=list)

    def add(self, triangles: NDArray[np.float32], material: Material | NDArray[np.uint8]) -> None:
        """Add triangles (n, 3, 3), all of one material or of theirs (n,)."""
        self.triangles.append(triangles)
        given = np.full(len(triangles), material, dtype=np.uint8) if isinstance(material, Material) else material
        self.materials.append(given)

    def finished(self, ground: Terrain) -> OpenWorld:
        """The world."""
        built = joined(self.blocks)
        triangles = np.concatenate([built.triangles(), *self.triangles]).astype(np.float32)
        materials = np.concatenate([built.triangle_materials(), *self.materials])
        return OpenWorld(triangles, materials, ground, np.array(self.slots).reshape(-1, 4))
