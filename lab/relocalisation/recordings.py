"""Maps and ways through them, described once and kept: what the table of relocalisation is made of."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path as Folder

import numpy as np
from numpy.typing import NDArray

from lab.distractors import SESSION_PLACES, made_up_places
from lab.worlds.drives import DrivenWorld, Leg, Ride
from lab.worlds.indoor import HALLS
from lab.worlds.towns import SimulatedDrive
from revisit.core.acceptance import Station
from revisit.core.config import PipelineConfig
from revisit.core.errors import RevisitError
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.model_bundle import ModelBundle, load_packaged_models
from revisit.core.pipeline import describe
from revisit.core.place import Place
from revisit.core.relocalisation.view_window import ViewCloud, ViewWindow
from revisit.core.submap import Submap
from revisit.evaluation.cutting import cut
from revisit.evaluation.datasets import Recording
from revisit.evaluation.real_data import real_data, real_recording
from revisit.evaluation.simulator import OS1_64, TownPlan

FURTHEST_M = 32.0
"""A conversation ends after so many metres."""

ELSEWHERE_M = 100_000.0
"""Places of other settings lie so far from those of a map."""


@dataclass(frozen=True)
class KnownPlace:
    """A described submap of the map, with the drive it is of; its pose there is that in the map."""

    place: Place
    vector: NDArray[np.float32]
    station: Station


@dataclass(frozen=True)
class SeenView:
    """A described view of a conversation: the way so far, its pose in odometry, and in the map where that is known."""

    travelled_m: float
    T_odom_view: Matrix4
    T_map_view: Matrix4
    place: Place | None
    vector: NDArray[np.float32] | None
    describe_s: float


@dataclass(frozen=True)
class Setting:
    """A map and the conversations that are held in it."""

    name: str
    config: PipelineConfig
    known: list[KnownPlace]
    conversations: list[list[SeenView]]


@dataclass(frozen=True)
class Sources:
    """A recording that is mapped, and others in whose frame conversations begin every `apart_m` metres.

    T_map_later (4, 4): from the frame of the later ones to that of the map; `step_m`: the way between views.
    """

    name: str
    config: PipelineConfig
    mapped: Recording
    later: Sequence[Recording]
    apart_m: float
    step_m: float = 5.0
    T_map_later: Matrix4 | None = None
    mapped_scans: Sequence[int] | None = None
    later_scans: Sequence[int] | None = None


def described(sources: Sources, models: ModelBundle) -> Setting:
    """The map and the views, described."""
    known = [_known(sources, number, window, models) for number, window in enumerate(_windows(sources))]
    held = [conversation for recording in sources.later for conversation in _conversations(recording, sources, models)]
    return Setting(sources.name, sources.config, [one for one in known if one is not None], held)


def kept(folder: Folder, name: str, make: Callable[[], Sources]) -> Setting:
    """A setting from the folder; described, and put there, if it is missing."""
    file = folder / f"{name}.pickle"
    if not file.exists():
        folder.mkdir(parents=True, exist_ok=True)
        file.write_bytes(pickle.dumps(described(make(), load_packaged_models())))
    found = pickle.loads(file.read_bytes())  # noqa: S301  # made by the line above
    assert isinstance(found, Setting)
    return found


def among_others(setting: Setting, others: Sequence[KnownPlace], count: int) -> Setting:
    """The setting with `count` places more in its map, far away: the `others` by turns, with made-up descriptors.

    The others must be described by the configuration of the setting.
    """
    pool = np.stack([one.vector for one in others])
    known = list(setting.known)
    for row, vector in enumerate(made_up_places(pool, count, np.random.default_rng(len(known)))):
        drive, ordinal = divmod(row, SESSION_PLACES)
        T = se3.from_yaw(0.0, (ELSEWHERE_M + 10.0 * ordinal, 200.0 * drive, 0.0))
        known.append(KnownPlace(others[row % len(others)].place, vector, Station(1 + drive, ordinal, T)))
    return replace(setting, known=known)


def _windows(sources: Sources) -> list[tuple[int, ...]]:
    return cut(sources.mapped, sources.config.submap, sources.mapped_scans)


def _known(sources: Sources, number: int, window: tuple[int, ...], models: ModelBundle) -> KnownPlace | None:
    submap = Submap.from_window([sources.mapped.scan(index) for index in window], sources.config.submap)
    try:
        found = describe(submap, models, sources.config)
    except RevisitError:
        return None
    return KnownPlace(found.place, found.descriptor.vector, Station(0, number, submap.T_odom_submap))


def _conversations(recording: Recording, sources: Sources, models: ModelBundle) -> Iterator[list[SeenView]]:
    """Views of the way from each start on."""
    scans = list(sources.later_scans or range(len(recording)))
    truth = np.array([recording.pose(index) for index in scans])
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1))])
    odometry = drifting(truth, seed=len(scans))
    T_map_later = np.eye(4) if sources.T_map_later is None else sources.T_map_later
    for start_m in np.arange(0.0, way[-1] - 15.0, sources.apart_m):
        first = int(np.searchsorted(way, start_m))
        rows = [row for row in range(first, len(scans)) if way[row] <= way[first] + FURTHEST_M]
        window, views, answered_m = ViewWindow(sources.config.submap), list[SeenView](), -np.inf
        for row in rows:
            try:
                cloud = window.add(recording.scan(scans[row]).points, odometry[row])
            except RevisitError:
                continue
            if window.travelled_m - answered_m >= sources.step_m - 1e-6:
                answered_m = window.travelled_m
                views.append(_seen(cloud, window.travelled_m, T_map_later @ truth[row], sources.config, models))
        yield views


def _seen(
    cloud: ViewCloud, travelled_m: float, T_map_view: Matrix4, config: PipelineConfig, models: ModelBundle
) -> SeenView:
    began = time.process_time()
    try:
        found = describe(cloud.submap, models, config)
    except RevisitError:
        return SeenView(travelled_m, cloud.T_odom_view, T_map_view, None, None, time.process_time() - began)
    spent = time.process_time() - began
    return SeenView(travelled_m, cloud.T_odom_view, T_map_view, found.place, found.descriptor.vector, spent)


def drifting(truth: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    """The poses (n, 4, 4) as an odometry has them: from an origin of its own, 0.5 % too long, turning as it goes."""
    rng = np.random.default_rng([seed, 53])
    T_odom_world = se3.from_yaw(rng.uniform(-np.pi, np.pi), (rng.uniform(-50, 50), rng.uniform(-50, 50), 0.0))
    poses = [T_odom_world @ truth[0]]
    for before, after in pairwise(truth):
        step = se3.inverse(before) @ after
        way_m = float(np.linalg.norm(step[:3, 3]))
        moved = step.copy()
        moved[:3, 3] *= 1.005
        noise = np.radians(rng.normal(0.0, 0.05) * np.sqrt(way_m))
        poses.append(poses[-1] @ moved @ se3.from_yaw(noise))
    return np.array(poses)


_NARROW = replace(OS1_64, columns=512)


def _hall(name: str, seed: int) -> Sources:
    hall = HALLS[name](seed)
    config = PipelineConfig()
    step, spacing = 5.0, 1.0
    if name == "office":
        config, step, spacing = config.of_map(0.25, {"tau": 5.0, "stride": 2.5}, {}, {}), 2.5, 0.5
    ride = Ride(_NARROW, spacing_m=spacing, height_m=1.2, seed=seed)
    mapped = DrivenWorld(name, hall.mapped, (Leg(hall.map_way),), ride)
    later = [
        DrivenWorld(name, hall.later, (Leg(way),), replace(ride, seed=seed + 1 + n)) for n, way in enumerate(hall.ways)
    ]
    return Sources(name, config, mapped, later, apart_m=21.0 if name != "office" else 10.0, step_m=step)


_MAPPED_STREETS = ((0, 0), (3, 0), (3, 1), (0, 1), (0, 2), (3, 2))
_LATER_STREETS = ((3, 2), (1, 2), (1, 0), (3, 0), (3, 3), (0, 3), (0, 1), (2, 1))


def _city(folder: Folder, seed: int) -> Sources:
    narrow = replace(_NARROW, columns=700)
    first = SimulatedDrive("reloc-city-map", seed, narrow, _MAPPED_STREETS, TownPlan(), block_m=60.0)
    second = SimulatedDrive("reloc-city-later", seed, narrow, _LATER_STREETS, TownPlan(), block_m=60.0, later=seed + 1)
    return Sources("city", PipelineConfig(), first.recorded(folder), [second.recorded(folder)], apart_m=40.0)


def _kitti(folder: Folder) -> Sources:
    recording = real_recording("kitti00_head", folder)
    even, odd = range(0, len(recording), 2), range(1, len(recording), 2)
    return Sources("kitti00 halves", PipelineConfig(), recording, [recording], 55.0, mapped_scans=even, later_scans=odd)


def _kitti_outside(folder: Folder) -> Sources:
    """The first half mapped, conversations in the second half, which is elsewhere."""
    recording = real_recording("kitti00_head", folder)
    half = len(recording) // 2
    return Sources(
        "kitti00 elsewhere", PipelineConfig(), recording, [recording], 75.0,
        mapped_scans=range(half), later_scans=range(half + 30, len(recording)),
    )  # fmt: skip


def _hku(folder: Folder) -> Sources:
    mapped, later = real_recording("hku1", folder), real_recording("hku2", folder)
    T = np.loadtxt(real_data() / "T_hku1_hku2.txt").reshape(-1, 4)
    T_map_later = np.eye(4)
    T_map_later[: len(T)] = T
    config = PipelineConfig().of_map(0.25, {}, {}, {})
    return Sources("hku", config, mapped, [later], 5.0, step_m=2.5, T_map_later=T_map_later)


def settings(folder: Folder) -> dict[str, Callable[[], Sources]]:
    """Every setting by name."""
    made: dict[str, Callable[[], Sources]] = {}
    for seed in (800, 801):
        for name in HALLS:
            made[f"{name}-{seed}"] = lambda name=name, seed=seed: _hall(name, seed)  # type: ignore[misc]
    made["city-810"] = lambda: _city(folder, 810)
    made["kitti"] = lambda: _kitti(folder)
    made["kitti-elsewhere"] = lambda: _kitti_outside(folder)
    made["hku"] = lambda: _hku(folder)
    return made
