"""Pins of plans and the submaps that hold them, by the version of the map in force."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry.se3 import pose_matrix
from revisit.service.domain.records import MapRecord, PlanRecord
from revisit.service.features.graph.map_frames import MapFrames
from revisit.service.features.graph.session_poses import PackedSubmaps
from revisit.service.features.plans.rules import HeldPin, PlanPin, PlanView
from revisit.service.ports.transactions import UnitOfWork

Placed = tuple[str, NDArray[np.int64], NDArray[np.float64]]
"""The name of a frame, and its submaps: numbers (n,) and poses (n, 4, 4)."""


def held_pins(uow: UnitOfWork, of_map: MapRecord, pins: Sequence[PlanPin]) -> tuple[str, tuple[HeldPin, ...]]:
    """The frame of a map with the most submaps, and the pins, held by submaps of it.

    Of a map without a version the frame is "", the odometry of its oldest session. A map without submaps holds no pin.
    """
    frame, numbers, T_map_submap = _largest_frame(uow, of_map) if of_map.map_version else _oldest_session(uow, of_map)
    if not len(numbers):
        return "", tuple(map(HeldPin, pins))
    return frame, tuple(_held(pin, numbers, T_map_submap) for pin in pins)


def _largest_frame(uow: UnitOfWork, of_map: MapRecord) -> Placed:
    """The frame of the version in force that has the most submaps."""
    rows = uow.session_poses.find(of_map.tenant, map_id=of_map.map_id, version=of_map.map_version)
    parts: dict[str, list[PackedSubmaps]] = {}
    for row in rows:
        parts.setdefault(row.frame, []).append(PackedSubmaps.of(row.submaps))
    if not parts:
        return _oldest_session(uow, of_map)
    frame = max(sorted(parts), key=lambda name: sum(len(one.numbers) for one in parts[name]))
    numbers = np.concatenate([one.numbers for one in parts[frame]])
    return frame, numbers, np.concatenate([one.T_map_submap for one in parts[frame]])


def _oldest_session(uow: UnitOfWork, of_map: MapRecord) -> Placed:
    """The odometry of the oldest session with submaps."""
    placed = uow.submaps.placed(of_map.tenant, of_map.map_id)
    oldest = min((one.session_number for one in placed), default=0)
    own = [one for one in placed if one.session_number == oldest]
    poses = np.array([one.T_odom_submap for one in own], dtype=np.float64).reshape(-1, 4, 4)
    return "", np.array([one.number for one in own], dtype=np.int64), poses


def _held(pin: PlanPin, numbers: NDArray[np.int64], T_map_submap: NDArray[np.float64]) -> HeldPin:
    """Held by the nearest of submaps: numbers (n,) and poses (n, 4, 4) in the frame of the pin; at its height."""
    positions = T_map_submap[:, :3, 3]
    nearest = int(np.argmin(np.linalg.norm(positions[:, :2] - pin.ground, axis=1)))
    T = T_map_submap[nearest]
    x, y, z = (T[:3, :3].T @ ([*pin.ground, positions[nearest, 2]] - positions[nearest])).tolist()
    return HeldPin(pin, int(numbers[nearest]), (x, y, z))


def plan_seen(uow: UnitOfWork, record: PlanRecord) -> PlanView:
    """A plan by the version in force; as it was set where one of its submaps is gone, or both share no frame."""
    first, second = (HeldPin.of(row) for row in record.pins)
    of_map = uow.maps.get(record.tenant, record.map_id)
    version = 0 if of_map is None else of_map.map_version
    as_set = PlanView(record, (first.pin, second.pin), record.frame, version)
    rows = uow.submaps.numbered(record.tenant, sorted({first.submap, second.submap} - {0}))
    if not {first.submap, second.submap} <= rows.keys():
        return as_set
    frames = MapFrames(uow, record.tenant, record.map_id, record=of_map)
    one, other = (frames.submap(rows[pin.submap]) for pin in (first, second))
    if one is None or other is None or one.frame != other.frame:
        return as_set
    pins = first.moved(np.asarray(pose_matrix(one.T_map))), second.moved(np.asarray(pose_matrix(other.T_map)))
    return PlanView(record, pins, one.frame, version)
