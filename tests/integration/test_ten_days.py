"""Ten days of one circuit in one map, whose policy keeps one view of a place: index and surfaces stay near those of one
session, bytes below half of those of one that keeps its scans; recall and poses stay; what stood for a while is gone
from the map of now; an eleventh day is recalled without the neural maps of what is retired. Simulated. Ten minutes of a
core.
"""

from __future__ import annotations

import asyncio
import io
import os
import sqlite3
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from lab.storage.weighing import DATABASE, OTHER, weigh
from revisit.core.config import LoopConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_matrix
from revisit.formats import DecodedCloud
from revisit.service.adapters.core_map_merger import CoreMapMerger
from revisit.service.adapters.core_recogniser import CoreRecogniser, load_recogniser
from revisit.service.adapters.core_tile_maker import CoreTileMaker
from revisit.service.domain.identity import SessionKey
from revisit.service.domain.retention import parsed
from revisit.service.domain.states import LoopState, SubmapState
from revisit.service.features.catalogue.downloads import DownloadKind
from revisit.service.features.catalogue.maps import CreateMap
from revisit.service.features.catalogue.sessions import CreateSession
from revisit.service.features.graph.session_poses import PackedSubmaps
from revisit.service.features.ingest.calls import AppendScan
from revisit.service.features.resources.paging import PageRequest
from tests.support.days_of_a_circuit import Circuit, Day
from tests.support.retained import DAY_MS, retained
from tests.support.service_world import TENANT, World, answered, sqlite_world

pytestmark = [pytest.mark.slow, pytest.mark.timeout(7200)]

DAYS = int(os.environ.get("REVISIT_CIRCUIT_DAYS", "10"))
POLICY = "scans=24h,best=1,rejected=1d"
RELEASED = f"{POLICY},retired=1d"
WITHIN_M, WITHIN_RAD = 2.0, np.radians(5.0)
"""A loop is right that is off by no more."""


@dataclass
class Grown:
    """What a map takes once a day is over and its policy was followed: submaps in the index, bytes of the tiles of its
    surface, bytes on the disk by part.
    """

    indexed: int
    surface_bytes: int
    parts: dict[str, int]

    @property
    def bytes(self) -> int:
        return sum(self.parts.values())


@dataclass
class Years:
    """What was driven, and what became of it; true poses by number of submap."""

    circuit: Circuit
    truth: dict[int, np.ndarray] = field(default_factory=dict)
    day_of: dict[int, int] = field(default_factory=dict)
    grown: dict[int, Grown] = field(default_factory=dict)
    recalled: dict[int, float] = field(default_factory=dict)
    false: list[str] = field(default_factory=list)
    loops: int = 0
    driven_bytes: int = 0
    """Of the first session, before any policy was followed."""
    released: dict[str, int] = field(default_factory=dict)
    """Bytes by part, of all days, once retired submaps have lost their neural maps."""
    moved_sigmas: float = 0.0
    points: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    """Of the surface of now, in the world (n, 3)."""
    error_m: float = 0.0


@pytest.fixture(scope="module")
def years(tmp_path_factory) -> Years:
    return asyncio.run(driven(tmp_path_factory.mktemp("years")))


async def driven(home: Path) -> Years:
    """Drive the days one after the other, each followed by a version of the map and a run of retention."""
    world, recogniser, years = sqlite_world(home), load_recogniser(), Years(Circuit())
    world.merger, world.tiler = CoreMapMerger(), CoreTileMaker()
    await world.use_cases.maps.create(TENANT, CreateMap("town", leave_distance_m=LoopConfig().leave_distance))
    await world.use_cases.retention.set(TENANT, "town", parsed(POLICY))
    for number in range(1, DAYS + 1):
        began_s = time.process_time()
        await drive_of(world, recogniser, years, years.circuit.of_day(number))
        described_s = time.process_time() - began_s
        await optimised(world)
        judge_loops(world, years, number)
        years.driven_bytes = years.driven_bytes or sum(weighed(home).values())
        before = poses(world)
        world.clock.ms += DAY_MS + 1
        await retained(world)
        await optimised(world)
        years.moved_sigmas = max(years.moved_sigmas, most_moved(before, poses(world)))
        if number in (1, DAYS):
            years.points = await surface(world, recogniser, years, number)
        found_by = f"recall {years.recalled[number]:.3f}, {len(years.false)} of {years.loops} loops false"
        print(
            f"day {number}: {described_s:.0f} CPU s, {found_by}, {counts(world)}, {years.grown.get(number)}", flush=True
        )
    years.error_m = place_in_world(world, years)
    await released(world, recogniser, years)
    world.context.transactions.close()
    return years


async def released(world: World, recogniser: CoreRecogniser, years: Years) -> None:
    """Retired submaps lose their neural maps; then one more day is driven."""
    before = poses(world)
    await retained(world, RELEASED)
    years.released, years.moved_sigmas = weighed(world.home), max(years.moved_sigmas, most_moved(before, poses(world)))
    await drive_of(world, recogniser, years, years.circuit.of_day(DAYS + 1))
    await optimised(world)
    judge_loops(world, years, DAYS + 1)


async def drive_of(world: World, recogniser: CoreRecogniser, years: Years, day: Day) -> None:
    key = SessionKey("town", f"day-{day.number:02d}")
    await world.use_cases.sessions.create(TENANT, CreateSession(*(key.map_id, key.session_id)))
    await world.use_cases.scans.open(TENANT, key)
    for seq, (scan, T_odom_sensor) in enumerate(zip(day.scans(), day.T_odom_sensor, strict=True), 1):
        cloud = DecodedCloud(np.ascontiguousarray(scan.points, dtype=np.float32))
        await world.use_cases.scans.append(TENANT, AppendScan(key, seq, scan.stamp_ns, T_odom_sensor, cloud))
        if seq % 20 == 0:
            world.work_off(recogniser)
    await world.use_cases.sessions.finish(TENANT, key)
    world.work_off(recogniser)
    for row in found(world, "submaps", session_id=key.session_id):
        nearest = np.abs(day.T_odom_sensor - pose_matrix(row.T_odom_submap)).sum(axis=(1, 2)).argmin()
        years.truth[row.number], years.day_of[row.number] = day.trajectory.T_world_sensor[nearest], day.number


async def optimised(world: World) -> None:
    await world.use_cases.map_versions.optimise(TENANT, "town")
    world.work_off()


def found(world: World, name: str, **equals):
    return world.context.transactions.read(
        lambda uow: getattr(uow, name).find(TENANT, map_id="town", **equals)
    ).result()


def counts(world: World) -> dict[str, int]:
    return dict(Counter(row.state for row in found(world, "submaps")))


def judge_loops(world: World, years: Years, number: int) -> None:
    """Note which submaps of a day have right loops to earlier days, and the false loops of all days."""
    accepted = found(world, "loops", state=LoopState.ACCEPTED.value)
    years.loops, years.false, right = len(accepted), [], set[int]()
    for loop in accepted:
        T_true = se3.inverse(years.truth[loop.match_number]) @ years.truth[loop.query_number]
        off = se3.inverse(T_true) @ pose_matrix(loop.T_match_query)
        if np.linalg.norm(off[:3, 3]) > WITHIN_M or se3.rotation_angle(off) > WITHIN_RAD:
            years.false.append(loop.loop_id)
        elif years.day_of[loop.match_number] < years.day_of[loop.query_number] == number:
            right.add(loop.query_number)
    own = [one for one, day in years.day_of.items() if day == number]
    years.recalled[number] = len(right) / len(own)


def poses(world: World) -> dict[int, tuple[np.ndarray, np.ndarray, str]]:
    """Positions (3,), their sigmas (3,) and frames of the submaps of the version in force, by number."""
    (record,) = world.context.transactions.read(lambda uow: uow.maps.find(TENANT)).result()
    placed = {}
    for row in found(world, "session_poses", version=record.map_version):
        packed = PackedSubmaps.of(row.submaps)
        sigmas = np.sqrt(np.einsum("nii->ni", packed.covariances.astype(np.float64))[:, :3])
        for place, one in enumerate(packed.numbers.tolist()):
            placed[one] = packed.T_map_submap[place], sigmas[place], row.frame
    return placed


def most_moved(before, after) -> float:
    """How far the pose of a submap moved at most, in its sigmas."""
    moved = [
        np.abs((se3.inverse(T) @ after[number][0])[:3, 3]) / np.maximum(sigmas, 1e-3)
        for number, (T, sigmas, frame) in before.items()
        if number in after and after[number][2] == frame
    ]
    assert before.keys() == after.keys()
    return float(np.max(moved, initial=0.0))


def weighed(home: Path) -> dict[str, int]:
    """Bytes on the disk by part: without tiles, which are made when asked for, and without free pages."""
    parts = {name: size for name, size in weigh(home).items() if name not in (OTHER, "map-tile")}
    with sqlite3.connect(home / "revisit.db") as database:
        pages, free, size = (
            database.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "freelist_count", "page_size")
        )
    return {**parts, DATABASE: (pages - free) * size}


async def surface(world: World, recogniser: CoreRecogniser, years: Years, number: int) -> np.ndarray:
    """Weigh what a day has left; the points of the surface of now, in the frame of the map (n, 3)."""
    parts = weighed(world.home)
    (record,) = world.context.transactions.read(lambda uow: uow.maps.find(TENANT)).result()
    page = await world.use_cases.map_tiles.list(TENANT, "town", record.map_version, PageRequest(500))
    neural, points = 0, []
    for tile in page.items:
        for kind, extension in ((DownloadKind.NEURAL, "rvn"), (DownloadKind.POINTS, "npy")):
            asked = world.use_cases.map_tiles.download(TENANT, tile.key, kind, extension)
            made = (await answered(world, asked, recogniser)).data
            neural += len(made) if kind is DownloadKind.NEURAL else 0
            points += [np.load(io.BytesIO(made))] if kind is DownloadKind.POINTS else []
    described = counts(world)[SubmapState.DESCRIBED.value]
    years.grown[number] = Grown(described, neural, parts)
    return np.concatenate(points)[:, :3].astype(np.float64)


def place_in_world(world: World, years: Years) -> float:
    """Move the points of now into the world by the rigid fit of all poses; the error of these, metres."""
    placed = {number: T for number, (T, _, _) in poses(world).items()}
    here, there = (np.array([one[number][:3, 3] for number in placed]) for one in (placed, years.truth))
    turn, _, other = np.linalg.svd((here - here.mean(0)).T @ (there - there.mean(0)))
    R = (turn @ np.diag([1.0, 1.0, np.linalg.det(turn @ other)]) @ other).T
    years.points = (years.points - here.mean(0)) @ R.T + there.mean(0)
    return float(np.sqrt(((((here - here.mean(0)) @ R.T + there.mean(0)) - there) ** 2).sum(axis=1).mean()))


def test_index_and_surface_are_twice_those_of_one_session_at_most_and_bytes_half_of_its_scans(years):
    first, last = years.grown[1], years.grown[DAYS]
    print(f"index {first.indexed} to {last.indexed}, surface {first.surface_bytes} to {last.surface_bytes}")
    print(f"bytes {years.driven_bytes} as driven, {first.bytes} {first.parts} to {last.bytes} {last.parts}")
    assert last.indexed <= 2 * first.indexed
    assert last.surface_bytes <= 2 * first.surface_bytes
    assert last.bytes <= 0.5 * years.driven_bytes


def test_neural_maps_of_all_days_that_are_left_take_two_and_a_half_times_those_of_one(years):
    of_first, of_all = (parts["neural maps"] for parts in (years.grown[1].parts, years.released))
    print(f"released: {sum(years.released.values())} {years.released}, recall {years.recalled[DAYS + 1]}")
    assert of_all <= 2.5 * of_first and years.recalled[DAYS + 1] >= 0.98


def test_the_last_day_is_recalled_and_no_loop_is_false(years):
    print(f"recall {years.recalled}, {len(years.false)} of {years.loops} false, map {years.error_m:.3f} m off")
    assert years.recalled[DAYS] >= 0.98 and years.false == [] and years.error_m <= 0.1


def test_no_pose_moves_by_retirement_beyond_its_sigma(years):
    print(f"moved by {years.moved_sigmas:.3f} sigmas at most")
    assert years.moved_sigmas <= 1.0


def test_the_wall_is_gone_and_containers_are_those_of_the_last_day(years):
    taken, now = years.circuit.taken(DAYS), years.circuit.with_containers(years.points)
    wall, right = years.circuit.of_wall(years.points).sum(), (taken == now).mean()
    print(f"{wall} points of the wall; containers {right:.3f} of {len(taken)}: {taken.sum()} stand, {now.sum()} shown")
    assert right >= 0.9 and (wall < 50 or DAYS in years.circuit.walled)
