"""Real facades: the LoD3 buildings of `ingolstadt`, with made-up ground, vegetation and parked cars among them."""

from __future__ import annotations

from pathlib import Path as Folder

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from lab.worlds import vegetation
from lab.worlds.open_world import OpenSolids, OpenWorld
from lab.worlds.relief import NearestHeights, ground_triangles
from revisit.evaluation.simulator.blocks import Floats, Material
from revisit.evaluation.simulator.paths import Path

# Along the streets between the buildings, in the frame of the mesh (metres).
_WAY = np.array(
    [
        [62, 136], [25, 132], [-5, 128.5], [-45, 128], [-57, 115], [-50, 88], [-37, 58], [-26, 40], [-8, 18], [0, 2],
        [10, -5], [22, -28], [38, -44], [56, -66], [64, -78], [55, -88], [35, -102], [8, -119], [-8, -135], [-30, -145],
        [-45, -165],
    ],
    dtype=np.float64,
)  # fmt: skip

_PLANTS, _SLOTS = 900, 130
_KEPT_FREE_M = 4.5


def facade_way() -> Path:
    """The way through the streets of the mesh."""
    return Path.through(_WAY).rounded(5.0)


def facade_world(folder: Folder, seed: int = 77) -> OpenWorld:
    """The buildings of `folder`/mesh.npz with plants and parked cars between them."""
    rng = np.random.default_rng([seed, 19])
    with np.load(folder / "mesh.npz") as mesh:
        buildings = mesh["v"][mesh["f"]].astype(np.float32)
    walls = _feet(buildings)
    ground, way = _ground(walls), facade_way()
    solids = OpenSolids()
    solids.add(buildings, Material.WALL)
    _plant(solids, way, walls, ground, rng)
    _mark_parking(solids, way, walls, ground, rng)
    solids.add(ground_triangles(ground, way.sampled(1.0).points, rng), Material.GROUND)
    return solids.finished(ground)


def _feet(buildings: NDArray[np.float32]) -> Floats:
    """Corners (n, 3) of upright structure."""
    normals = np.cross(buildings[:, 1] - buildings[:, 0], buildings[:, 2] - buildings[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    return buildings[np.abs(normals[:, 2]) < 0.3].reshape(-1, 3).astype(np.float64)


def _ground(walls: Floats, cell_m: float = 15.0) -> NearestHeights:
    """The mesh has no ground: it lies at the feet of the walls, smoothed."""
    low, high = walls[:, :2].min(axis=0) - 60.0, walls[:, :2].max(axis=0) + 60.0
    axes = [np.arange(a, b, 4.0) for a, b in zip(low, high, strict=True)]
    xy = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    cells, inverse = np.unique(np.floor(walls[:, :2] / cell_m), axis=0, return_inverse=True)
    lowest = np.full(len(cells), np.inf)
    np.minimum.at(lowest, inverse.ravel(), walls[:, 2])
    weight = 1.0 / (np.linalg.norm(xy[:, :, None] - (cells + 0.5) * cell_m, axis=-1) ** 3 + 50.0)
    smooth = RegularGridInterpolator(axes, gaussian_filter((weight * lowest).sum(-1) / weight.sum(-1), 2.0))
    return NearestHeights(np.column_stack([xy.reshape(-1, 2), smooth(xy.reshape(-1, 2))]))


def _plant(solids: OpenSolids, way: Path, walls: Floats, ground: NearestHeights, rng: np.random.Generator) -> None:
    driven, standing = cKDTree(way.sampled(1.0).points), cKDTree(walls[:, :2])
    spots = way.at(rng.uniform(0, way.length, _PLANTS)) + rng.normal(scale=22.0, size=(_PLANTS, 2))
    free = (driven.query(spots)[0] > _KEPT_FREE_M) & (standing.query(spots)[0] > 1.5)
    for spot in spots[free]:
        solids.add(*vegetation.plant(np.append(spot, float(ground.terrain(spot))), rng))


def _mark_parking(
    solids: OpenSolids, way: Path, walls: Floats, ground: NearestHeights, rng: np.random.Generator
) -> None:
    standing = cKDTree(walls[:, :2])
    arcs = rng.uniform(0, way.length, _SLOTS)
    spots = way.beside(arcs, rng.choice([-1.0, 1.0], _SLOTS) * rng.uniform(3.8, 4.8, _SLOTS))
    for arc, spot in zip(arcs[standing.query(spots)[0] > 1.5], spots[standing.query(spots)[0] > 1.5], strict=True):
        yaw = float(way.heading(np.array([arc]))[0])
        solids.slots.append((float(spot[0]), float(spot[1]), float(ground.terrain(spot)), yaw))
