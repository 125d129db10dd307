"""What every simulated world is made of, and how it is built: blocks and loose triangles, each with its material."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from revisit.evaluation.simulator.blocks import Blocks, Material, joined


@dataclass(frozen=True)
class Structure:
    """The part of a world that stays: triangles (t, 3, 3) in metres with materials (t,)."""

    triangles: NDArray[np.float32]
    materials: NDArray[np.uint8]


@dataclass
class Solids:
    """Blocks and loose triangles while a world is being built."""

    blocks: list[Blocks] = field(default_factory=list)
    triangles: list[NDArray[np.float32]] = field(default_factory=list)
    materials: list[NDArray[np.uint8]] = field(default_factory=list)

    def add(self, triangles: NDArray[np.float32], material: Material | NDArray[np.uint8]) -> None:
        """Add triangles (n, 3, 3), all of one material or of theirs (n,)."""
        self.triangles.append(triangles)
        given = np.full(len(triangles), material, dtype=np.uint8) if isinstance(material, Material) else material
        self.materials.append(given)

    def built(self) -> Structure:
        """Blocks first, then loose triangles, each in the order in which they came."""
        blocks = joined(self.blocks)
        triangles = np.concatenate([blocks.triangles(), *self.triangles]).astype(np.float32)
        return Structure(triangles, np.concatenate([blocks.triangle_materials(), *self.materials]))
