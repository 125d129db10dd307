"""Made-up worlds that repeat: garage, warehouse, orchard, row houses, corridor, solar park, container yard.

Geometry alone cannot tell one bay from the next there, so a pair of submaps that lie a period apart must not be
accepted as a loop. Surfaces are sampled without ray casting: only faces that look towards the sensor are seen, thinner
with range.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.bev import describe_bev
from revisit.core.clusters import segment_clusters
from revisit.core.config import PipelineConfig
from revisit.core.descriptor.vlad import Codebooks
from revisit.core.geometry import se3
from revisit.core.place import Place
from revisit.core.place.extraction import extract_place
from revisit.core.surface import Surface
from revisit.core.verification import VerifiedLoop, verify
from revisit.evaluation.described_submaps import DescribedSubmap
from revisit.evaluation.drive_acceptance import AskedPlaces
from revisit.evaluation.loop_closure_method import Description

Array64 = NDArray[np.float64]
Samples = tuple[Array64, Array64]

RIGHT_M, RIGHT_DEG = 1.0, 5.0
"""A pose is right that is off by less."""

REACH_M = 45.0
"""How far a visit sees."""

_SENSOR_HEIGHT_M = 1.6
_POINTS_PER_M2 = 14.0
_FULL_DENSITY_M = 12.0  # farther away, the density falls with the inverse of the range
_NOISE_M = 0.02


@dataclass(frozen=True)
class World:
    """A world that repeats every `period_m` along x and, where it says so, every `aisle_m` along y.

    cell(lasting, passing) gives points and normals, each (n, 3), of one period from x = 0 on, z = 0 the ground:
    `lasting` is random and the same in every visit to this period, `passing` differs from visit to visit. Of the rows
    along x, `rows_seen` are visible on either side. After the period `last` stands a hall across the way, and nothing.
    """

    name: str
    period_m: float
    cell: Callable[[np.random.Generator, np.random.Generator], Samples]
    aisle_m: float | None = None
    rows_seen: int = 6
    last: int | None = None


@dataclass(frozen=True)
class RepeatingPair:
    """Two visits: their poses (4, 4) in the world, and by how many periods and aisles the second one is off."""

    world: str
    query: Place
    match: Place
    T_world_query: se3.Matrix4
    T_world_match: se3.Matrix4
    periods: int
    aisles: int

    @property
    def T_match_query(self) -> se3.Matrix4:
        """The true pose of the query in the frame of the match."""
        return se3.inverse(self.T_world_match) @ self.T_world_query

    @property
    def same(self) -> bool:
        """Whether both visits are to the same place."""
        return self.periods == 0 and self.aisles == 0


def repeating_pairs(
    world: World, count: int, seed: int, codebooks: Codebooks, config: PipelineConfig
) -> Iterator[RepeatingPair]:
    """`count` pairs of visits, by turns to the same place and to one that is 1 to 3 periods, or an aisle, away."""
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        aisles = int(number % 4 == 3 and world.aisle_m is not None)
        periods = int(rng.integers(1, 4)) if number % 2 and not aisles else 0
        offset = np.array([periods * world.period_m, aisles * (world.aisle_m or 0.0), 0.0])
        poses = [_standpoint(rng), se3.from_yaw(0.0, tuple(offset)) @ _standpoint(rng)]
        query, match = (visit(world, pose, [seed, number, k], seed, codebooks, config) for k, pose in enumerate(poses))
        yield RepeatingPair(world.name, query, match, poses[0], poses[1], periods, aisles)


@dataclass(frozen=True)
class Visit:
    """One visit: the place, its pose (4, 4) in the world, and the period and aisle it was in."""

    place: Place
    T_world_sensor: se3.Matrix4
    period: int
    aisle: int


def visits_of(world: World, count: int, seed: int, codebooks: Codebooks, config: PipelineConfig) -> list[Visit]:
    """`count` visits to periods 0 to 3 and, where there are any, to two aisles, by turns."""
    made = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        period, aisle = number % 4, int(number % 3 == 2 and world.aisle_m is not None)
        offset = (period * world.period_m, aisle * (world.aisle_m or 0.0), 0.0)
        pose = se3.from_yaw(0.0, offset) @ _standpoint(rng)
        place = visit(world, pose, [seed, number, 0], seed, codebooks, config)
        made.append(Visit(place, pose, period, aisle))
    return made


def drawn_pairs(world: World, visits: list[Visit], count: int, seed: int, *, same: bool) -> Iterator[RepeatingPair]:
    """At most `count` pairs of visits drawn at random, none twice: of one place, or a period or an aisle apart."""
    pairs = [(query, match) for query in visits for match in visits if query is not match]
    fitting = [pair for pair in pairs if same == ((pair[0].period, pair[0].aisle) == (pair[1].period, pair[1].aisle))]
    order = np.random.default_rng([seed, 3]).permutation(len(fitting))[:count]
    for query, match in (fitting[int(index)] for index in order):
        yield RepeatingPair(
            world.name, query.place, match.place, query.T_world_sensor, match.T_world_sensor,
            match.period - query.period, match.aisle - query.aisle,
        )  # fmt: skip


def two_drives(world: World, count: int, seed: int, codebooks: Codebooks, config: PipelineConfig) -> AskedPlaces:
    """Two drives along x with `count` submaps each, a stride apart: the second, perhaps the other way, asks the first.

    Their poses are true, as of a perfect odometry; frames of their own.
    """
    rng, drives = np.random.default_rng([seed, 5]), []
    for drive, (start_m, turn) in enumerate(((0.0, 0.0), (rng.uniform(-5.0, 5.0), rng.choice([0.0, np.pi])))):
        poses = [on_the_way(start_m + number * config.submap.stride, turn, rng) for number in range(count)]
        poses = poses[::-1] if turn else poses
        drives.append([described(world, pose, (seed, drive, n), codebooks, config) for n, pose in enumerate(poses)])
    return AskedPlaces(drives[1], drives[0], one_drive=False)


def on_the_way(x_m: float, turn: float, rng: np.random.Generator) -> se3.Matrix4:
    """A pose (4, 4) of a drive along x, towards `turn`."""
    return se3.from_yaw(turn + rng.normal(0.0, 0.03), (x_m, rng.uniform(-0.6, 0.6), _SENSOR_HEIGHT_M))


def described(
    world: World, pose: se3.Matrix4, of: tuple[int, int, int], codebooks: Codebooks, config: PipelineConfig
) -> DescribedSubmap:
    """The submap in a row of a drive, `of`: seed, drive, row. It has no descriptor: all places here look alike."""
    seed, _, row = of
    place = visit(world, pose, list(of), seed, codebooks, config)
    description = Description(np.zeros(1, np.float32), place.to_blob())
    return DescribedSubmap(row, (row,), pose[:3, 3], pose, 0.0, description, None, len(place.points))


@dataclass(frozen=True)
class Judgement:
    """The verification of a pair alone.

    accepted; `right`: the pose it accepts, or would accept, is the true one; `among`: the true pose is that one or one
    of the hypotheses (rivals).
    """

    accepted: bool
    right: bool
    among: bool

    @property
    def false(self) -> bool:
        """Whether a wrong pose was accepted."""
        return self.accepted and not self.right


def judge(pair: RepeatingPair, config: PipelineConfig) -> Judgement:
    """Verify a pair alone; a pose is right within 1 m and 5 degrees (periods are longer)."""
    verdict = verify(pair.query, pair.match, 1.0, config.verification)
    accepted, measured = isinstance(verdict, VerifiedLoop), verdict.measurement
    if measured is None:
        return Judgement(accepted, right=False, among=False)
    poses = [measured.T_match_query, *(rival.T_match_query for rival in measured.rivals)]
    errors = [se3.inverse(pair.T_match_query) @ pose for pose in poses]
    right = [
        is_right(float(np.linalg.norm(error[:3, 3])), float(np.degrees(se3.rotation_angle(error)))) for error in errors
    ]
    return Judgement(accepted, right[0], any(right))


def is_right(metres: float, degrees: float) -> bool:
    """Whether a pose that is off by so much is right here: periods are short."""
    return metres < RIGHT_M and degrees < RIGHT_DEG


def visit(
    world: World,
    T_world_sensor: se3.Matrix4,
    visit_seed: list[int],
    world_seed: int,
    codebooks: Codebooks,
    config: PipelineConfig,
) -> Place:
    """The place that is seen from a pose."""
    points, normals = _seen(world, T_world_sensor, visit_seed, world_seed)
    surface = surface_of_samples(points, normals, config.implicit_map.resolution)
    clusters = segment_clusters(surface, config.clusters)
    bev = describe_bev(surface, clusters, config.bev)
    return extract_place(surface, clusters, bev, codebooks, config.verification)


def surface_of_samples(points: Array64, normals: Array64, resolution_m: float) -> Surface:
    """Points (n, 3) with unit normals (n, 3) as a surface without faces; the voxels they fall in are occupied."""
    occupied = np.unique(np.floor(points / resolution_m).astype(np.int32), axis=0)
    return Surface(
        points.astype(np.float32), normals.astype(np.float32), np.zeros((0, 3), np.int32), occupied,
        np.ones(len(occupied), np.float32), resolution_m,
    )  # fmt: skip


def _standpoint(rng: np.random.Generator) -> se3.Matrix4:
    """A pose of the sensor near the middle of the period at x = 0, with any heading."""
    x, y = rng.uniform(-1.0, 1.0), rng.uniform(-0.6, 0.6)
    return se3.from_yaw(rng.uniform(-np.pi, np.pi), (x, y, _SENSOR_HEIGHT_M))


def _seen(world: World, T_world_sensor: se3.Matrix4, visit_seed: list[int], world_seed: int) -> Samples:
    """The view of a visit, in its own frame: faces towards the sensor, thinned with range, with noise."""
    rng = np.random.default_rng([*visit_seed, 7])
    samples = [_ground(T_world_sensor[:3, 3], rng)]
    first = int(np.floor((T_world_sensor[0, 3] - REACH_M) / world.period_m))
    for cell in range(first, first + int(np.ceil(2 * REACH_M / world.period_m)) + 1):
        for row in _rows(world, T_world_sensor[1, 3]):
            lasting = np.random.default_rng([world_seed, cell + 1000, row + 1000])
            passing = np.random.default_rng([*visit_seed, cell + 1000, row + 1000])
            if world.last is not None and cell > world.last:
                if cell > world.last + 1:
                    continue
                points, normals = _hall(passing)
            else:
                points, normals = world.cell(lasting, passing)
            samples.append((points + [cell * world.period_m, row * (world.aisle_m or 0.0), 0.0], normals))
    points, normals = (np.concatenate(part) for part in zip(*samples, strict=True))
    T_sensor_world = se3.inverse(T_world_sensor)
    points, normals = se3.apply(T_sensor_world, points), normals @ T_sensor_world[:3, :3].T
    distance = np.linalg.norm(points, axis=1)
    seen = (np.einsum("ij,ij->i", points, normals) < 0.0) & (distance < REACH_M)
    seen &= rng.random(len(points)) < _FULL_DENSITY_M / np.maximum(distance, _FULL_DENSITY_M)
    return points[seen] + rng.normal(0.0, _NOISE_M, (int(seen.sum()), 3)), normals[seen]


def _rows(world: World, y: float) -> range:
    if world.aisle_m is None:
        return range(1)
    middle = round(y / world.aisle_m)
    return range(middle - world.rows_seen, middle + world.rows_seen + 1)


def _ground(around: Array64, rng: np.random.Generator) -> Samples:
    flat = rng.uniform(-REACH_M, REACH_M, (12_000, 2)) + around[:2]
    return np.column_stack([flat, np.zeros(len(flat))]), np.tile([0.0, 0.0, 1.0], (len(flat), 1))


def plate(centre: tuple[float, float, float], across: Array64, up: Array64, rng: np.random.Generator) -> Samples:
    """Samples of a rectangle: its middle and its two half edges (3,); it looks along their cross product."""
    normal = np.cross(across, up)
    area = 4.0 * float(np.linalg.norm(normal))
    steps = rng.uniform(-1.0, 1.0, (max(1, rng.poisson(area * _POINTS_PER_M2)), 2))
    points = np.asarray(centre) + steps @ np.stack([across, up])
    return points, np.tile(normal / np.linalg.norm(normal), (len(points), 1))


def box(
    middle: tuple[float, float], size: tuple[float, float, float], rng: np.random.Generator, bottom: float = 0.0
) -> Samples:
    """Samples of the four sides and the top of an upright box: width along x, depth along y, height, metres."""
    (x, y), (w, d, h) = middle, (size[0] / 2, size[1] / 2, size[2] / 2)
    z = bottom + h
    ex, ey, ez = w * np.eye(3)[0], d * np.eye(3)[1], h * np.eye(3)[2]
    return joined([
        plate((x + w, y, z), ey, ez, rng), plate((x - w, y, z), -ey, ez, rng),
        plate((x, y + d, z), -ex, ez, rng), plate((x, y - d, z), ex, ez, rng), plate((x, y, z + h), ex, ey, rng),
    ])  # fmt: skip


def crown(centre: tuple[float, float, float], radius: float, rng: np.random.Generator) -> Samples:
    """Samples of a rough ball of leaves."""
    count = int(4.0 * np.pi * radius**2 * _POINTS_PER_M2 * 0.5)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(centre) + normals * radius * rng.uniform(0.8, 1.05, (count, 1)), normals


def joined(parts: list[Samples]) -> Samples:
    """Several samples as one."""
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def _cars(slots: list[tuple[float, float]], share: float, along_x: bool, rng: np.random.Generator) -> list[Samples]:
    parked = []
    for x, y in slots:
        if rng.random() < share:
            length, width = rng.uniform(3.8, 4.8), rng.uniform(1.6, 1.9)
            size = (length, width, 1.5) if along_x else (width, length, 1.5)
            parked.append(box((x + rng.uniform(-0.2, 0.2), y + rng.uniform(-0.3, 0.3)), size, rng))
    return parked


def _hall(passing: np.random.Generator) -> Samples:
    """The end of a world: a hall across the way with a porch, and a tree beside it."""
    return joined([
        box((14.0, 3.0), (8.0, 44.0, 11.0), passing), box((8.5, -9.0), (3.0, 7.0, 4.0), passing),
        crown((5.0, 11.0, 3.5), 2.5, passing),
    ])  # fmt: skip


def _garage(lasting: np.random.Generator, passing: np.random.Generator) -> Samples:
    parts = [box((4.0, y), (0.5, 0.5, 2.6), passing) for y in (-8.0, 8.0)]
    parts += [box((4.0, y), (0.5, 0.9, 2.6), passing) for y in (-13.0, 13.0)]
    parts += [plate((4.0, y, 1.3), np.array([4.0 * s, 0, 0]), np.array([0, 0, 1.3]), passing)
              for y, s in ((-16.0, -1.0), (16.0, 1.0))]  # fmt: skip
    parts += [box((4.0, 0.0), (0.4, 32.0, 0.4), passing, bottom=2.4)]
    slots = [(x, y) for x in (1.3, 4.0, 6.7) for y in (-10.7, 10.7)]
    if lasting.random() < 0.1:
        parts.append(box((lasting.uniform(1, 7), 15.6), (1.0, 0.6, 2.0), passing))
    return joined(parts + _cars(slots, 0.5, along_x=False, rng=passing))


def _warehouse(lasting: np.random.Generator, passing: np.random.Generator) -> Samples:
    parts = [box((0.0, y), (0.12, 0.12, 6.5), passing) for y in (2.45, 3.55)]
    for level in (0.2, 2.2, 4.2):
        parts.append(box((1.35, 3.0), (2.7, 1.1, 0.12), passing, bottom=level))
        for slot in (0.7, 2.0):
            if lasting.random() < 0.97 and passing.random() < 0.93:
                size = (1.2, 1.0, passing.choice([1.2, 1.5]))
                parts.append(box((slot, 3.0), size, passing, bottom=level + 0.12))
    return joined(parts)


def _orchard(lasting: np.random.Generator, passing: np.random.Generator) -> Samples:
    x, y = 2.0 + lasting.normal(0, 0.15), 2.7 + lasting.normal(0, 0.15)
    radius, height = lasting.uniform(1.1, 1.5), lasting.uniform(2.2, 2.6)
    return joined([box((x, y), (0.2, 0.2, height), passing), crown((x, y, height), radius, passing)])


def _row_houses(lasting: np.random.Generator, passing: np.random.Generator) -> Samples:
    parts = []
    for side in (-1.0, 1.0):
        parts.append(box((5.0, side * 14.0), (9.4, 9.0, 6.5), passing))
        parts.append(box((2.0, side * 9.0), (1.8, 1.0, 2.6), passing))
        parts.append(box((7.0, side * 9.2), (2.4, 0.6, 5.0), passing))
        if lasting.random() < 0.3:
            parts.append(crown((lasting.uniform(1, 9), side * 7.5, 1.0), 0.9, passing))
    slots = [(x, y) for x in (2.6, 7.4) for y in (-5.5, 5.5)]
    return joined(parts + _cars(slots, 0.4, along_x=True, rng=passing))


def _corridor(lasting: np.random.Generator, passing: np.random.Generator) -> Samples:
    """A hotel corridor four times as large, as a scene scale of 0.25 makes it: niches with doors every 16 m."""
    parts = []
    for side in (-1.0, 1.0):
        wall, niche = np.array([0.0, side * 4.0, 0.0]), np.array([0.0, side * 5.6, 0.0])
        across, up = np.array([6.0 * side, 0, 0]), np.array([0, 0, 5.0])
        parts.append(plate((6.0, wall[1], 5.0), across, up, passing))
        parts.append(plate((14.0, niche[1], 5.0), across / 3, up, passing))
        for x, facing in ((12.0, 1.0), (16.0, -1.0)):
            parts.append(plate((x, side * 4.8, 5.0), np.array([0, 0.8 * facing, 0]), up, passing))
        if lasting.random() < 0.1:
            parts.append(box((lasting.uniform(2, 10), side * 3.8), (2.0, 0.4, 3.0), passing, bottom=4.0))
        if passing.random() < 0.3:
            parts.append(box((passing.uniform(2, 10), side * 3.2), (3.0, 1.6, 4.0), passing))
    return joined(parts)


def _solar_park(lasting: np.random.Generator, passing: np.random.Generator) -> Samples:
    tilt, y = np.radians(25.0 + lasting.normal(0, 0.5)), 3.5
    up = 1.6 * np.array([0.0, np.cos(tilt), np.sin(tilt)])
    across = np.array([5.5, 0.0, 0.0])
    centre = (6.0 + lasting.normal(0, 0.05), y, 1.6)
    posts = [box((x, y), (0.2, 0.2, 1.4), passing) for x in (2.0, 6.0, 10.0)]
    return joined([plate(centre, across, up, passing), plate(centre, -across, up, passing), *posts])


def _container_yard(lasting: np.random.Generator, passing: np.random.Generator) -> Samples:
    """Stacks of equal containers; one stack in ten is lower."""
    parts = []
    for y in (5.0, 7.6):
        height = 2.6 * (1 if lasting.random() < 0.1 else 2)
        parts.append(box((6.5, y), (12.2, 2.45, height), passing))
    return joined(parts)


WORLDS = (
    World("garage", 8.0, _garage),
    World("warehouse", 2.7, _warehouse, aisle_m=6.0, rows_seen=1),
    World("orchard", 4.0, _orchard, aisle_m=5.4),
    World("row houses", 10.0, _row_houses),
    World("corridor at scale 0.25", 16.0, _corridor),
    World("solar park", 12.0, _solar_park, aisle_m=7.0),
    World("container yard", 13.0, _container_yard, aisle_m=10.5),
)
"""All worlds of the suite; periods from 2.7 to 16 m."""
