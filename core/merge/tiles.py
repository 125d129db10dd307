"""A large map piece by piece: the fused surface of a square of it, a tile, out of the neural maps that reach it.

Tiles of one frame lie on a grid whose edges are multiples of a voxel, so that the surfaces of neighbours meet: each is
made with a margin around it, and a triangle belongs to the tile that its centre lies in.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.codec.mesh import Mesh
from revisit.core.codec.tile import EMPTY, FusedTile
from revisit.core.config import SurfaceConfig
from revisit.core.geometry import se3
from revisit.core.geometry.tile_grid import TILE_VOXELS
from revisit.core.implicit_map import NeuralMap
from revisit.core.merge.evidence import DatedChange
from revisit.core.merge.fused import PlacedMap, merge_neural_maps
from revisit.core.merge.history import changes_over_time
from revisit.core.merge.overlap import points_in_map
from revisit.core.merge.standing import standing, still_standing
from revisit.core.surface import extract_surface

Array = NDArray[np.float32]

MARGIN_VOXELS = 6
"""The margin that decides on a tile's surface: a voxel is meshed by neural points within less than three voxels."""

THING_VOXELS = 16
"""Of a thing that the border of a tile cuts, so much beyond the margin counts."""


def fuse_tile(
    placed: Iterable[PlacedMap], centre_m: NDArray[np.float64], config: SurfaceConfig = SurfaceConfig()
) -> FusedTile | None:
    """The surface of the tile whose square has its middle at `centre_m` (3,) in the frame of the `placed` maps.

    Of maps of several drives it is the surface that the latest of them left (`standing`).
    Lengths are metres from that middle; z is that of the map's frame. The neural map reaches a margin beyond the
    square, and its level frame leads to the frame of the map. The mesh meets those of the neighbours; the points are
    the neural points in the square. None where none of the maps has points there. Raises as `merge_neural_maps`.
    """
    moved = _about(centre_m, placed)
    cropped = [one for one in map(_cropped, still_standing(moved, _judged_m(moved))) if len(one.neural_map.points)]
    if not cropped:
        return None
    fused = merge_neural_maps(cropped)
    scale, half = fused.frame.scale, 0.5 * TILE_VOXELS * fused.config.resolution
    surface = extract_surface(fused, config)
    vertices, normals, faces = _within(surface.vertices, surface.normals, surface.faces, half)
    inside = _in_square(fused.points.positions, half)
    points, directions = fused.points.positions[inside], fused.points.normals[inside]
    factor, frame = np.float32(scale), replace(fused.frame, translation=centre_m)
    fused = replace(fused, frame=frame)
    mesh, of_points = Mesh(vertices * factor, normals, faces), Mesh(points * factor, directions, EMPTY.faces)
    return FusedTile(fused.to_blob(), mesh, of_points)


def changes_in_tile(placed: Iterable[PlacedMap], centre_m: NDArray[np.float64]) -> list[DatedChange]:
    """What drives found changed in the square of a tile, in the frame of the `placed` maps, in the order of time.

    A thing belongs to the tile that its centre lies in.
    """
    moved = _about(centre_m, placed)
    if len({one.session for one in moved}) < 2:
        return []
    found = changes_over_time(moved, _judged_m(moved))
    centres = np.array([one.thing.centre_m for one in found]).reshape(-1, 3)
    inside = _in_square(centres.astype(np.float32), _half_m(moved))
    return [one.moved_by(centre_m) for one, its in zip(found, inside, strict=True) if its]


def standing_in_tile(placed: Iterable[PlacedMap], centre_m: NDArray[np.float64]) -> list[NDArray[np.bool_]]:
    """Which points (n,) of each of the maps still stand (`standing`); those outside the square of the tile do."""
    moved = _about(centre_m, placed)
    stands = standing(moved, _judged_m(moved))
    inside = (_in_square(points_in_map(one).astype(np.float32), _half_m(moved)) for one in moved)
    return [its | ~here for its, here in zip(stands, inside, strict=True)]


def distances_m(neural_map: NeuralMap, points: NDArray[np.floating]) -> tuple[Array, Array]:
    """Signed distances (n,) of `points` (n, 3) in the map to a tile's surface, all in metres, positive in free space.

    They are cut at the truncation of the field. The second array (n,) is the distance to the nearest neural point, inf
    where none is near: there the field says nothing.
    """
    frame = neural_map.frame
    values, nearest = neural_map.sdf(frame.points_to_level(points).astype(np.float32))
    return values * np.float32(frame.scale), nearest * np.float32(frame.scale)


def _about(centre_m: NDArray[np.float64], placed: Iterable[PlacedMap]) -> list[PlacedMap]:
    """The maps in a frame with its origin at `centre_m` (3,)."""
    T_tile_map = se3.from_rotation_translation(np.eye(3), -centre_m)
    return [replace(one, T_map_submap=T_tile_map @ one.T_map_submap) for one in placed]


def _half_m(moved: Sequence[PlacedMap], beyond_voxels: int = 0) -> float:
    """Half an edge of a tile and so many voxels, metres."""
    if not moved:
        return 0.0
    neural_map = moved[0].neural_map
    return (0.5 * TILE_VOXELS + beyond_voxels) * neural_map.config.resolution * neural_map.frame.scale


def _judged_m(moved: Sequence[PlacedMap]) -> float:
    """How far from its middle a tile says what still stands: things are judged whole that its border cuts."""
    return _half_m(moved, MARGIN_VOXELS + THING_VOXELS)


def _cropped(one: PlacedMap) -> PlacedMap:
    """A map with those of its points alone that lie in the tile or its margin."""
    neural_map = one.neural_map
    T_tile_upright = one.T_map_submap @ neural_map.frame.T_submap_upright
    scale, resolution = neural_map.frame.scale, neural_map.config.resolution
    T_level = se3.from_rotation_translation(T_tile_upright[:3, :3], T_tile_upright[:3, 3] / scale)
    here = se3.apply(T_level, neural_map.points.positions)
    reach = (0.5 * TILE_VOXELS + MARGIN_VOXELS) * resolution
    return one.only(np.abs(here[:, :2]).max(axis=1, initial=0.0) < reach)


def _in_square(positions: Array, half: float) -> NDArray[np.bool_]:
    """Which positions (n, 3) lie in the square, whose lower edges belong to it."""
    return np.asarray(((positions[:, :2] >= -half) & (positions[:, :2] < half)).all(axis=1))


def _within(
    vertices: Array, normals: Array, faces: NDArray[np.int32], half: float
) -> tuple[Array, Array, NDArray[np.int32]]:
    """The triangles whose centre lies in the square, and their vertices."""
    kept = faces[_in_square(vertices[faces].mean(axis=1), half)] if len(faces) else faces
    used, renumbered = np.unique(kept, return_inverse=True)
    return vertices[used], normals[used], renumbered.reshape(-1, 3).astype(np.int32)
