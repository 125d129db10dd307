"""Every domain by name. Seeds 700 to 799 are for these worlds only; no model is trained on any of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path as Folder

import numpy as np
from numpy.typing import NDArray

from lab.worlds.drives import DrivenWorld, Leg, Ride, backwards, winding_way
from lab.worlds.facades import facade_way, facade_world
from lab.worlds.overgrown_towns import as_overgrown
from lab.worlds.recorded_ways import kitti_path
from lab.worlds.resimulation import beside_where_free, driven_way, resimulated_world
from lab.worlds.towns import MIXED as TOWN_ROUTE
from lab.worlds.towns import SimulatedDrive
from lab.worlds.verge import CANYON, MIXED, ROW_HOUSES, WOODS, Style, grow
from revisit.core.config import SubmapConfig
from revisit.core.geometry import se3
from revisit.core.scan import Scan
from revisit.evaluation.datasets import Recording
from revisit.evaluation.metrics import LoopProtocol
from revisit.evaluation.perturbations import Perturbation
from revisit.evaluation.real_data import MISSING, has_real_data, real_data, real_recording
from revisit.evaluation.simulator import HDL32, HDL64, OS1_64, VLP16, LidarModel, Path

_WAY_M, _BACK_M = 1_000.0, 600.0
_SPARSE = SubmapConfig(stride=10.0)
_DENSE = SubmapConfig(stride=5.0)


@dataclass(frozen=True)
class Pass:
    """Recordings to judge by: one that meets itself, or queries that are sought in another one.

    `mapped` is None for one drive in which a query may be matched with earlier submaps only.
    """

    queries: Recording
    mapped: Recording | None = None
    thinned_queries: Perturbation = Perturbation(rotate_seed=1)
    thinned_map: Perturbation = Perturbation(rotate_seed=1)


@dataclass(frozen=True)
class Setting:
    """The scale of a domain: the folder of cached results, and the driven share of a winding way."""

    folder: Folder
    share: float = 1.0


@dataclass(frozen=True)
class Domain:
    """A world, how it is driven, and how it is cut.

    `make` gives the recordings. `needs_data`: they rest on real data, in the folder that REVISIT_DATA names.
    """

    name: str
    meaning: str
    make: Callable[[Setting], Pass]
    submap: SubmapConfig = _SPARSE
    loops: LoopProtocol = LoopProtocol(min_index_gap=15)
    needs_data: bool = False

    @property
    def missing(self) -> str | None:
        """Why it cannot be run here, None where it can."""
        return MISSING if self.needs_data and not has_real_data() else None


def _narrow(sensor: LidarModel, columns: int) -> LidarModel:
    return replace(sensor, columns=columns)


def there_and_back(name: str, style: Style, sensor: LidarModel, seed: int, setting: Setting) -> Pass:
    """A winding way through a made-up world, and a part of it back on the other lane."""
    way = winding_way(setting.share * _WAY_M, seed)
    legs = (Leg(way, 1.5), Leg(backwards(way, way.length - setting.share * _BACK_M), 1.5))
    return Pass(DrivenWorld(name, grow(way, style, seed), legs, Ride(sensor, seed=seed)))


_TOWN = SimulatedDrive("domain-town", 711, VLP16, TOWN_ROUTE, block_m=60.0)


def _town(setting: Setting) -> Pass:
    return Pass(_TOWN.recorded(setting.folder))


def _overgrown_town(setting: Setting) -> Pass:
    return Pass(as_overgrown(_TOWN).recorded(setting.folder))


def _round_a_block(_: Setting) -> Pass:
    block = np.array([[0, 0], [70, 0], [70, 55], [0, 55], [0, 0]], dtype=np.float64)
    rounds = np.concatenate([block, block[1:], block[-2::-1], [[-40, -30]]])
    world = grow(Path.through(np.concatenate([block, [[70, 0]]])).rounded(6.0), MIXED, 760)
    ride = Ride(_narrow(VLP16, 180), spacing_m=1.0, height_m=1.0, seed=760)
    return Pass(DrivenWorld("thin-block", world, (Leg(Path.through(rounds).rounded(6.0)),), ride))


def _kitti_way(_: Setting) -> Pass:
    way = kitti_path(np.loadtxt(real_data() / "trajectories/05.txt"))
    half = way.length / 2
    legs = (Leg(_part(way, 0.0, half), 1.2), Leg(_part(way, half, way.length), -1.5))
    return Pass(DrivenWorld("kitti05-way", grow(way, MIXED, 770), legs, Ride(_narrow(HDL64, 800), seed=770)))


def _facades(_: Setting) -> Pass:
    way = facade_way()
    legs = (Leg(way, 1.0), Leg(backwards(way), 1.0))
    world = facade_world(real_data() / "ingolstadt")
    return Pass(DrivenWorld("facades", world, legs, Ride(_narrow(HDL32, 900), seed=780)))


def _resimulated(setting: Setting) -> Pass:
    recording = real_recording("kitti00_head", setting.folder)
    world, way = resimulated_world(recording), driven_way(recording)
    back = beside_where_free(world, backwards(way), -2.2, 1.9)
    return Pass(DrivenWorld("resimulated", world, (Leg(way), Leg(back)), Ride(_narrow(OS1_64, 800), seed=790)))


def _halves(setting: Setting) -> Pass:
    recording = real_recording("kitti00_head", setting.folder)
    return Pass(SomeScans("odd-scans", recording, 1), SomeScans("even-scans", recording, 0))


def _thin_queries(setting: Setting) -> Pass:
    return replace(_halves(setting), thinned_queries=_THIN)


def _thin_map(setting: Setting) -> Pass:
    return replace(_halves(setting), thinned_map=_THIN)


def _beams_queries(setting: Setting) -> Pass:
    return replace(_halves(setting), thinned_queries=_BEAMS)


def _view_queries(setting: Setting) -> Pass:
    return replace(_halves(setting), thinned_queries=_VIEW)


def _view_in_beams(setting: Setting) -> Pass:
    return replace(_halves(setting), thinned_queries=_VIEW, thinned_map=_BEAMS)


_THIN = Perturbation(keep_beams=16, keep_points=0.06, rotate_seed=2)
_BEAMS = Perturbation(keep_beams=16, rotate_seed=2)
_VIEW = Perturbation(rotate_seed=3, view_deg=120.0)


class SomeScans:
    """Every second scan of a recording, from `first` on."""

    def __init__(self, name: str, recording: Recording, first: int) -> None:
        self._recording, self._chosen, self._name = recording, range(first, len(recording), 2), name

    @property
    def name(self) -> str:
        """See Recording."""
        return self._name

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """See Recording."""
        return self._recording.stamps_ns[list(self._chosen)]

    def __len__(self) -> int:
        return len(self._chosen)

    def __iter__(self) -> Iterator[Scan]:
        return (self.scan(index) for index in range(len(self)))

    def pose(self, index: int) -> se3.Matrix4:
        """See Recording."""
        return self._recording.pose(self._chosen[index])

    def scan(self, index: int) -> Scan:
        """See Recording."""
        return self._recording.scan(self._chosen[index])


def _part(way: Path, start_m: float, end_m: float) -> Path:
    return Path.through(way.at(np.arange(start_m, end_m, 1.0)))


_SHORT_GAP = LoopProtocol(min_index_gap=20)

DOMAINS: tuple[Domain, ...] = (
    Domain("town", "simulated town, the generator of the training data; VLP-16, all kinds of passes", _town),
    Domain("overgrown-town", "the same town and drive with more plants, and errors of poses and beams",
           _overgrown_town),
    Domain("country-road", "other generator; OS1-64, driven back on the other lane",
           partial(there_and_back, "country-road", MIXED, _narrow(OS1_64, 800), 720)),
    Domain("row-houses", "other generator, houses of one kind; HDL-64, driven back",
           partial(there_and_back, "row-houses", ROW_HOUSES, _narrow(HDL64, 800), 730)),
    Domain("canyon", "other generator, closed fronts on both sides; HDL-64, driven back",
           partial(there_and_back, "canyon", CANYON, _narrow(HDL64, 800), 740)),
    Domain("woods", "other generator, trees alone; HDL-32, driven back",
           partial(there_and_back, "woods", WOODS, _narrow(HDL32, 900), 750)),
    Domain("thin-block", "other generator, thin scans round a block, twice and back; VLP-16 of 180 shots",
           _round_a_block, _DENSE, _SHORT_GAP),
    Domain("kitti05-way", "other generator along KITTI 05, second half 2.7 m aside; HDL-64", _kitti_way,
           needs_data=True),
    Domain("facades", "real facades, made-up plants and cars; HDL-32, driven back", _facades, _DENSE,
           LoopProtocol(min_index_gap=30), needs_data=True),
    Domain("resimulated", "surfaces of a real street (KITTI 00), cast from 2.2 m aside, driven back; OS1-64",
           _resimulated, loops=_SHORT_GAP, needs_data=True),
    Domain("real-halves", "real street, odd scans among even ones", _halves, needs_data=True),
    Domain("real-thin-queries", "real street, odd scans of 16 beams and 6 % of their points among even ones",
           _thin_queries, needs_data=True),
    Domain("real-thin-map", "real street, odd scans among even ones of 16 beams and 6 % of their points",
           _thin_map, needs_data=True),
    Domain("real-16-beams", "real street, odd scans of 16 beams among even ones of 64", _beams_queries,
           needs_data=True),
    Domain("real-solid-state", "real street, odd scans with a view of 120 degrees among even ones of 360",
           _view_queries, needs_data=True),
    Domain("real-solid-state-of-16", "real street, odd scans with a view of 120 degrees among even ones of 16 beams",
           _view_in_beams, needs_data=True),
)  # fmt: skip
