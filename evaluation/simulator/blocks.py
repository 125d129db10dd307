"""Tapered blocks: the one solid that houses, roofs, cars, poles and people of the simulated city are made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


class Material(IntEnum):
    """The material of a triangle: decides how much light it returns."""

    GROUND = 0
    GRASS = 1
    WALL = 2
    GLASS = 3
    ROOF = 4
    LEAF = 5
    METAL = 6
    CLOTH = 7
    WINDSCREEN = 8


@dataclass(frozen=True)
class Blocks:
    """n upright blocks.

    base (n, 3) centre of the lower face, half (n, 2) half extents, height (n,), yaw (n,) radians, top (n, 2) the size
    of the upper face over the lower one: (1, 1) a box, (1, 0) a gabled roof; material (n,).
    """

    base: Floats
    half: Floats
    height: Floats
    yaw: Floats
    top: Floats
    material: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.base)

    def placed(self, position: ArrayLike, yaw: float) -> Blocks:
        """The blocks of a local frame put at `position` (3,) metres and turned by `yaw` radians."""
        c, s = np.cos(yaw), np.sin(yaw)
        turned = self.base @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        return Blocks(turned + np.asarray(position), self.half, self.height, self.yaw + yaw, self.top, self.material)

    def triangles(self) -> NDArray[np.float32]:
        """The faces of all blocks, (12 n, 3, 3): block by block, corner coordinates in metres."""
        lower = _SIGNS * self.half[:, None]
        upper = lower * self.top[:, None]
        flat = np.concatenate([lower, upper], axis=1)
        c, s = np.cos(self.yaw)[:, None], np.sin(self.yaw)[:, None]
        corners = np.empty((len(self), 8, 3))
        corners[..., 0] = c * flat[..., 0] - s * flat[..., 1]
        corners[..., 1] = s * flat[..., 0] + c * flat[..., 1]
        corners[..., 2] = np.repeat([0.0, 1.0], 4) * self.height[:, None]
        corners += self.base[:, None]
        return corners[:, _FACES].reshape(-1, 3, 3).astype(np.float32)

    def triangle_materials(self) -> NDArray[np.uint8]:
        """The material of every triangle of `triangles()`, (12 n,)."""
        return np.repeat(self.material, len(_FACES))


_SIGNS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], dtype=np.float64)
_FACES = np.array(
    [
        [0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7], [0, 1, 5], [0, 5, 4],
        [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7],
    ]
)  # fmt: skip


def block(
    centre: Sequence[float], size: Sequence[float], material: Material, top: tuple[float, float] = (1.0, 1.0)
) -> Blocks:
    """One block: `centre` (x, y, z of the lower face) and `size` (length, width, height), metres, in a local frame."""
    return Blocks(
        base=np.array([centre], dtype=np.float64), half=np.array([[size[0] / 2, size[1] / 2]]),
        height=np.array([size[2]], dtype=np.float64), yaw=np.zeros(1), top=np.array([top], dtype=np.float64),
        material=np.array([material], dtype=np.uint8),
    )  # fmt: skip


def joined(parts: Sequence[Blocks]) -> Blocks:
    """All blocks of `parts`, in order; none for an empty sequence."""
    if not parts:
        none, flat = np.zeros(0), np.zeros((0, 2))
        return Blocks(np.zeros((0, 3)), flat, none, none, flat, np.zeros(0, np.uint8))
    return Blocks(
        base=np.concatenate([part.base for part in parts]), half=np.concatenate([part.half for part in parts]),
        height=np.concatenate([part.height for part in parts]), yaw=np.concatenate([part.yaw for part in parts]),
        top=np.concatenate([part.top for part in parts]), material=np.concatenate([part.material for part in parts]),
    )  # fmt: skip
