"""Drives of real or simulated sensors as maps of a service without processes, described by the real method."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from revisit.core.config import LoopConfig
from revisit.core.geometry import se3
from revisit.formats import DecodedCloud
from revisit.service.adapters.core_map_merger import CoreMapMerger
from revisit.service.adapters.core_recogniser import CoreRecogniser
from revisit.service.adapters.core_tile_maker import CoreTileMaker
from revisit.service.domain.identity import SessionKey
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.ingest.calls import AppendScan
from revisit.service.features.merging.calls import MergeMap
from tests.support.service_world import TENANT, World, memory_world

Drive = Iterable[tuple[np.ndarray, np.ndarray]]
"""Points (n, 3) in the sensor's frame, and T_world_sensor (4, 4)."""


def real_world(**overrides: Any) -> World:
    """A service whose merges are those of the product."""
    world = memory_world(**overrides)
    world.merger = CoreMapMerger()
    world.tiler = CoreTileMaker()
    return world


def random_start(rng: np.random.Generator) -> np.ndarray:
    """T_odom_world: any heading, anywhere; z points up in both, as odometry with an inertial sensor has it."""
    return se3.from_yaw(rng.uniform(-np.pi, np.pi), rng.uniform(-200.0, 200.0, 3))


async def driven(
    world: World, map_id: str, drive: Drive, T_odom_world: np.ndarray, recogniser: CoreRecogniser, **of_map: Any
) -> None:
    """Store a drive as the only session `day` of a map, and describe its submaps."""
    key = SessionKey(map_id, "day")
    await opened(world, key, **of_map)
    await driven_on(world, key, drive, T_odom_world, recogniser)
    await world.use_cases.sessions.finish(TENANT, key)
    world.work_off(recogniser)


async def opened(world: World, key: SessionKey, **of_map: Any) -> None:
    """Create a session, and its map.

    As in the product, and unlike in other tests, neighbours within a drive are no loops.
    """
    of_map = {"leave_distance_m": LoopConfig().leave_distance, **of_map}
    await world.use_cases.maps.create(TENANT, CreateMap(key.map_id, **of_map))
    await world.use_cases.sessions.create(TENANT, CreateSession(key.map_id, key.session_id))
    await world.use_cases.scans.open(TENANT, key)


async def driven_on(
    world: World, key: SessionKey, drive: Drive, T_odom_world: np.ndarray, recogniser: CoreRecogniser, after: int = 0
) -> None:
    """Store a part of a drive, whose first scan is the next one behind `after`, and describe its whole submaps."""
    for seq, (points, T_world_sensor) in enumerate(drive, after + 1):
        cloud = DecodedCloud(np.ascontiguousarray(points, dtype=np.float32))
        await world.use_cases.scans.append(
            TENANT, AppendScan(key, seq, seq * 100, T_odom_world @ T_world_sensor, cloud)
        )
    world.work_off(recogniser)


async def merged(world: World, into: str, source: str, recogniser: CoreRecogniser, **asked: Any) -> dict[str, Any]:
    """The result of a merge, or of a dry run."""
    posted = await world.use_cases.map_merges.merge(TENANT, MergeMap(into, source, **asked))
    world.work_off(recogniser)
    return (await world.use_cases.operations.get(TENANT, posted.operation.operation_id)).result


def offset(
    result: dict[str, Any], T_first_world: np.ndarray, T_second_world: np.ndarray, at: np.ndarray
) -> tuple[float, float]:
    """How far an alignment is off at `at` (3,) of the world: metres and degrees."""
    T = np.reshape(result["T_map_source"], (4, 4))
    apart = se3.inverse(T_first_world) @ T @ T_second_world
    moved = se3.apply(apart, at[None])[0] - at
    return float(np.linalg.norm(moved)), float(np.degrees(se3.rotation_angle(apart)))
