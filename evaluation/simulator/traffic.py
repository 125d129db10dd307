"""Things that do not stay: parked cars change between visits, cars and people move with time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.evaluation.simulator.blocks import Blocks, Floats, Material, block, joined
from revisit.evaluation.simulator.paths import Path


def _car(length: float, width: float, height: float, bonnet: float) -> Blocks:
    body = height * 0.55
    cabin = length - bonnet
    wheels = [
        block((x * length * 0.3, y * (width / 2 - 0.12), 0.0), (0.62, 0.22, 0.62), Material.METAL)
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    shell = block((0, 0, 0.22), (length, width, body - 0.22), Material.METAL, (0.97, 0.94))
    glass = block(((-bonnet) / 2 + 0.1, 0, body), (cabin, width * 0.92, height - body), Material.WINDSCREEN, (0.7, 0.8))
    return joined([*wheels, shell, glass])


VEHICLES: tuple[Blocks, ...] = (
    _car(4.0, 1.75, 1.50, 0.9),
    _car(4.6, 1.82, 1.45, 1.3),
    _car(4.4, 1.85, 1.68, 1.0),
    _car(5.2, 2.00, 2.20, 0.6),
    _car(6.4, 2.20, 2.90, 0.5),
)
PERSON: Blocks = joined(
    [
        block((0, 0.09, 0), (0.16, 0.14, 0.85), Material.CLOTH),
        block((0.1, -0.09, 0), (0.16, 0.14, 0.85), Material.CLOTH),
        block((0, 0, 0.8), (0.26, 0.46, 0.65), Material.CLOTH, (0.9, 0.8)),
        block((0, 0, 1.46), (0.2, 0.18, 0.26), Material.CLOTH),
    ]
)

VISIBLE_M = 85.0


@dataclass(frozen=True)
class ParkingSlots:
    """Kerbside slots: position (n, 3) metres, yaw (n,) radians, share of them that is taken at any visit."""

    position: Floats
    yaw: Floats
    taken: float
    seed: int

    def occupant(self, slot: int, visit: int) -> Blocks | None:
        """The car in `slot` at the `visit`-th visit, or None; the same arguments give the same answer."""
        rng = np.random.default_rng([self.seed, 21, slot, visit])
        if rng.random() > self.taken:
            return None
        kind = int(rng.choice(len(VEHICLES), p=[0.3, 0.3, 0.25, 0.12, 0.03]))
        shift = np.append(rng.normal(0.0, [0.35, 0.08]), 0.0)
        turn = rng.normal(0.0, 0.02) + (np.pi if rng.random() < 0.3 else 0.0)
        return VEHICLES[kind].placed(self.position[slot] + shift, float(self.yaw[slot]) + turn)


class ParkedCars:
    """The parked cars of a drive: after leaving a slot's surroundings, a return finds another car or none."""

    def __init__(self, slots: ParkingSlots) -> None:
        self._slots = slots
        self._visits = np.zeros(len(slots.yaw), dtype=np.int64)
        self._near = np.zeros(len(slots.yaw), dtype=bool)
        self._cars: dict[int, Blocks | None] = {}

    def around(self, xy: Floats) -> list[Blocks]:
        """The cars within sight of `xy` (2,); call it in the order of the drive."""
        near = np.linalg.norm(self._slots.position[:, :2] - xy, axis=1) < VISIBLE_M + 15.0 * self._near
        arrived = near & ~self._near
        self._visits += arrived
        self._near = near
        for slot in np.flatnonzero(arrived):
            self._cars[int(slot)] = self._slots.occupant(int(slot), int(self._visits[slot]))
        cars = [self._cars[int(slot)] for slot in np.flatnonzero(near)]
        return [car for car in cars if car is not None]


@dataclass(frozen=True)
class Traffic:
    """Moving cars and people, each a function of time.

    street (n,) which path it follows, offset_m (n,) to the left of it, speed_mps (n,) signed, start_m (n,) where it
    is at time zero, kind (n,) index into VEHICLES, or -1 for a person.
    """

    paths: tuple[Path, ...]
    street: NDArray[np.int64]
    offset_m: Floats
    speed_mps: Floats
    start_m: Floats
    kind: NDArray[np.int64]

    def poses(self, time_s: float) -> tuple[Floats, Floats]:
        """Positions (n, 2) and headings (n,) at `time_s` seconds."""
        position, heading = np.zeros((len(self.street), 2)), np.zeros(len(self.street))
        for index, path in enumerate(self.paths):
            mine = self.street == index
            arc = np.mod(self.start_m[mine] + self.speed_mps[mine] * time_s, path.length)
            position[mine] = path.beside(arc, self.offset_m[mine])
            heading[mine] = path.heading(arc) + np.where(self.speed_mps[mine] < 0, np.pi, 0.0)
        return position, heading


LANE_M = 1.7


def random_traffic(
    streets: list[Path], cars_per_km: float, people_per_km: float, pavement_m: float, rng: np.random.Generator
) -> Traffic:
    """Cars that keep to the right lane and people on the pavement, `pavement_m` from the middle of the street."""
    rows: list[tuple[int, float, float, float, int]] = []
    for index, path in enumerate(streets):
        for _ in range(rng.poisson(cars_per_km * path.length / 1000.0)):
            forward = 1.0 if rng.random() < 0.5 else -1.0
            speed = forward * rng.uniform(6.0, 14.0)
            kind = int(rng.integers(len(VEHICLES)))
            rows.append((index, -forward * LANE_M, speed, rng.uniform(0, path.length), kind))
        for _ in range(rng.poisson(people_per_km * path.length / 1000.0)):
            side = rng.choice([-1.0, 1.0])
            speed = rng.choice([-1.0, 1.0]) * rng.uniform(0.7, 1.7)
            rows.append((index, side * (pavement_m + rng.uniform(-0.7, 0.7)), speed, rng.uniform(0, path.length), -1))
    table = np.array(rows, dtype=np.float64).reshape(-1, 5)
    return Traffic(
        paths=tuple(streets), street=table[:, 0].astype(np.int64), offset_m=table[:, 1], speed_mps=table[:, 2],
        start_m=table[:, 3], kind=table[:, 4].astype(np.int64),
    )  # fmt: skip
