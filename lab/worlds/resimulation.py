"""Real surfaces from other paths: a recording's surfaces as the product reconstructs them, ray-cast anew."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from lab.worlds.open_world import OpenWorld
from lab.worlds.relief import NearestHeights
from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.implicit_map import fit_implicit_map
from revisit.core.model_bundle import load_packaged_models
from revisit.core.submap import Submap
from revisit.core.surface import extract_surface
from revisit.evaluation.datasets import Recording
from revisit.evaluation.simulator.blocks import Floats, Material
from revisit.evaluation.simulator.lidar import Scene
from revisit.evaluation.simulator.paths import Path

_SCANS, _STEP = 10, 6  # scans of one reconstruction, and from one to the next
_REACH_M = 35.0
_SENSOR_HEIGHT_M = 1.73
_BODY_M = 1.3  # a car needs this much room to its sides


def resimulated_world(recording: Recording, config: PipelineConfig = PipelineConfig()) -> OpenWorld:
    """The surfaces near the driven way. Moving objects of the recording stay as smears."""
    starts = range(0, max(1, len(recording) - _SCANS + 1), _STEP)
    triangles = np.concatenate([_reconstructed(recording, start, config) for start in starts])
    way = np.array([recording.pose(index)[:3, 3] for index in range(len(recording))])
    ground = NearestHeights(way - [0.0, 0.0, _SENSOR_HEIGHT_M])
    return OpenWorld(triangles, np.full(len(triangles), Material.WALL, dtype=np.uint8), ground)


def driven_way(recording: Recording) -> Path:
    """Where the recording's sensor went."""
    return Path.through(np.array([recording.pose(index)[:2, 3] for index in range(len(recording))]))


def beside_where_free(world: OpenWorld, way: Path, left_m: float, height_m: float) -> Path:
    """The way moved by up to `left_m` metres to its left, less where something stands there.

    The recorded line was free, but beside it cars are parked, and a sensor inside of one sees nothing at all.
    """
    dense = way.sampled(1.0)
    scene = Scene(world.triangles, world.materials)
    room = np.array([_room(scene, world, dense, arc, left_m, height_m) for arc in dense.arc])
    # early enough and long enough: the narrowest spot of 8 m, then smoothed
    narrow = minimum_filter1d(room, 9, mode="nearest")
    smooth = np.convolve(np.pad(narrow, 4, mode="edge"), np.ones(9) / 9, mode="valid")
    return Path.through(dense.beside(dense.arc, np.sign(left_m) * np.minimum(smooth, room)))


def _room(scene: Scene, world: OpenWorld, way: Path, arc: float, left_m: float, height_m: float) -> float:
    """How far to the side a sensor can stand at an arc length, metres: 0 to |left_m|."""
    yaw = float(way.heading(np.array([arc]), 4.0)[0])
    side = np.sign(left_m) * np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    xy = way.at(np.array([arc]))[0]
    origin = np.append(xy, float(world.ground.terrain(xy)) + 0.9)
    free = scene.cast(origin, side[None].astype(np.float32)).range_m[0]
    above = scene.cast(origin + [0.0, 0.0, height_m - 0.9], side[None].astype(np.float32)).range_m[0]
    return float(np.clip(min(free, above) - _BODY_M, 0.0, abs(left_m)))


def _reconstructed(recording: Recording, start: int, config: PipelineConfig) -> NDArray[np.float32]:
    """Triangles (n, 3, 3) in the world of one stretch of scans, near its middle."""
    scans = [recording.scan(index) for index in range(start, min(start + _SCANS, len(recording)))]
    submap = Submap.from_window(scans, config.submap)
    field = fit_implicit_map(
        submap.levelled(), load_packaged_models().decoder, config.implicit_map, np.random.default_rng(0)
    )
    surface = extract_surface(field, config.surface)
    triangles: Floats = surface.vertices[surface.faces].astype(np.float64)
    near = np.linalg.norm(triangles.mean(axis=1)[:, :2], axis=1) < _REACH_M
    T_world_level = submap.levelled().T_odom_submap
    return se3.apply(T_world_level, triangles[near].reshape(-1, 3)).reshape(-1, 3, 3).astype(np.float32)
