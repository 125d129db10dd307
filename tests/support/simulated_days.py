"""Simulated days of one street: parked cars are drawn anew each day, and a wall stands on some of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.merge.fused import PlacedMap
from revisit.core.model_bundle import load_packaged_models
from revisit.core.pipeline import describe
from revisit.core.scan import Scan
from revisit.core.submap import Submap, SubmapBuilder
from revisit.evaluation.simulator.blocks import Material, block
from revisit.evaluation.simulator.city import World
from revisit.evaluation.simulator.lidar import simulate
from revisit.evaluation.simulator.paths import Path
from revisit.evaluation.simulator.sensors import HDL64, LidarModel
from revisit.evaluation.simulator.trajectories import drive

DAY_S = 86_400.0


def scans_of(
    world: World, street: Path, number: int, lane_m: float, start_s: float, sensor: LidarModel = HDL64
) -> Iterator[Scan]:
    """The scans of a drive along the street, at their true poses."""
    trajectory = drive(street, world.ground, lane_m=lane_m, spacing_m=1.5, sway_seed=number, start_s=start_s)
    for scan in simulate(world, trajectory, sensor, seed=number):
        yield Scan.validated(scan.points, scan.T_world_sensor, scan.stamp_ns)


def day(
    world: World, street: Path, number: int, lane_m: float, start_s: float, sensor: LidarModel = HDL64
) -> list[PlacedMap]:
    """The neural maps of a drive along the street, at their true poses: session `number`."""
    models, config = load_packaged_models(), PipelineConfig()
    builder, maps = SubmapBuilder(config.submap), []
    for scan in scans_of(world, street, number, lane_m, start_s, sensor):
        window = builder.add(scan)
        if window is not None:
            submap = Submap.from_scans(window, config.submap)
            neural_map = describe(submap, models, config).neural_map
            maps.append(PlacedMap(neural_map, submap.T_odom_submap, number, int(window[-1].stamp_ns)))
    return maps


def parked_anew(world: World, number: int) -> World:
    """The town with every parked car drawn anew."""
    return dataclasses.replace(world, parking=dataclasses.replace(world.parking, seed=world.parking.seed + number))


def with_wall(world: World, middle: tuple[float, float], length_m: float, height_m: float = 2.2) -> World:
    """The town with a wall along x, 0.3 m thick, on the ground at `middle`."""
    base = float(world.ground.height(np.array([middle]))[0])
    wall = block((*middle, base), (length_m, 0.3, height_m), Material.WALL)
    return dataclasses.replace(
        world,
        triangles=np.concatenate([world.triangles, wall.triangles()]),
        materials=np.concatenate([world.materials, wall.triangle_materials()]),
    )


def empty(world: World) -> World:
    """The town without cars and people: everything in it stays."""
    none = dataclasses.replace(
        world.traffic,
        **{
            field.name: getattr(world.traffic, field.name)[:0]
            for field in dataclasses.fields(world.traffic)
            if field.name != "paths"
        },
    )
    return dataclasses.replace(world, parking=dataclasses.replace(world.parking, taken=0.0), traffic=none)


def returns_of(world: World, street: Path, lane_m: float) -> np.ndarray:
    """All returns (n, 3) of a drive through a town, metres in the world."""
    scans = scans_of(world, street, 1, lane_m, 0.0)
    return np.concatenate([se3.apply(one.T_odom_sensor, one.points.astype(np.float64)) for one in scans])
