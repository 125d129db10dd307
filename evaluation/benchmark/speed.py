"""The cost of one submap, one candidate and one search, beside other methods on the same submaps."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import PipelineConfig, SubmapConfig
from revisit.core.geometry import se3
from revisit.core.index import FaissIndex, IndexEntry, SearchFilter
from revisit.core.model_bundle import ModelBundle
from revisit.core.pipeline import DescribedPlace, describe, verify
from revisit.core.place import Place
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.evaluation.baselines import ScanContext
from revisit.evaluation.benchmark.timing import Work
from revisit.evaluation.simulator import HDL64, StreetGrid, Trajectory, build_city, drive, grid_drive, simulate

Vectors = NDArray[np.float32]

TOWN_SEED = 4_711
SEARCHES = 50
CANDIDATES = 20
SPACING_M = 0.15
"""Between the scans of a dense submap: 10 Hz at 1.5 m/s."""
_PEERS = (ScanContext(),)
PEERS = frozenset({*(f"describe_{peer.name}" for peer in _PEERS), "verify_small_gicp"})
"""Works of others: their slower times are no regression of the product."""
_VOXEL_M = 0.3


@dataclass(frozen=True)
class Visits:
    """10 m submaps of simulated streets seen by 64 beams: a place, its revisit in reverse, and another place.

    Scans a metre apart; `dense` is cut from 67, of which those that are described are chosen. `along` is the way there,
    evenly: the candidates of a query.
    """

    place: Submap
    revisit: Submap
    elsewhere: Submap
    dense: Submap
    along: tuple[Submap, ...]


def two_streets(candidates: int = 0) -> Visits:
    """Along a street and back in the opposite lane; of the way there so many submaps."""
    grid = StreetGrid.random(3, 3, TOWN_SEED)
    world = build_city(grid.streets(), TOWN_SEED)
    path = grid_drive(grid, [(0, 0), (1, 0), (2, 0), (1, 0), (0, 0)])

    def submap(share: float, spacing_m: float, scans: int) -> Submap:
        trajectory = drive(path, world.ground, lane_m=1.8, spacing_m=spacing_m)
        first = round(len(trajectory) * share) - scans // 2
        part = slice(first, first + scans)
        seen = simulate(
            world, Trajectory(trajectory.T_world_sensor[part], trajectory.stamps_ns[part]), HDL64, TOWN_SEED
        )
        checked = [Scan.validated(scan.points, scan.T_world_sensor, scan.stamp_ns) for scan in seen]
        return Submap.from_window(checked, SubmapConfig())

    place, revisit, elsewhere = (submap(share, 1.0, 11) for share in (0.25, 0.75, 0.4))
    along = tuple(submap(share, 1.0, 11) for share in np.linspace(0.05, 0.45, candidates))
    return Visits(place, revisit, elsewhere, submap(0.25, SPACING_M, 67), along)


def describing(visits: Visits, models: ModelBundle, config: PipelineConfig) -> dict[str, Work]:
    """From scans to descriptor: the product, and the descriptors of others."""
    points = visits.place.levelled().points
    peers: dict[str, Work] = {f"describe_{peer.name}": _later(peer.describe, points) for peer in _PEERS}
    return {
        "describe": lambda: describe(visits.place, models, config),
        "describe_67_scans": lambda: describe(visits.dense, models, config),
        **peers,
    }


def verifying(
    visits: Visits, places: tuple[DescribedPlace, ...], models: ModelBundle, config: PipelineConfig
) -> dict[str, Work]:
    """One candidate, read from its stored form, of a query that had others: one that aligns and one that does not.

    Beside them all the candidates of a query, one after the other, as a worker has them that has met them before.
    small_gicp, where it is installed, registers the clouds of the first from the pose that the product has found: it
    has nothing to recognise.
    """
    place, revisit, elsewhere = places

    def verification(match: DescribedPlace) -> Work:
        similarity, blob = revisit.descriptor.similarity(match.descriptor), match.place.to_blob()
        return lambda: verify(revisit.place, Place.from_blob(blob), similarity, config.verification)

    works = {"verify_accepted": verification(place), "verify_rejected": verification(elsewhere)}
    works["verify_query"] = _query(revisit, [describe(one, models, config) for one in visits.along], config)
    found = verify(revisit.place, place.place, 1.0, config.verification)
    if importlib.util.find_spec("small_gicp") and found.measurement is not None:
        works["verify_small_gicp"] = _registration(visits, found.measurement.T_match_query)
    return works


def searching(count: int, dimension: int) -> Work:
    """SEARCHES for the 20 nearest among `count` places, a robot's own surroundings left out; descriptors are made up.

    They vary in 60 directions, as those of real drives do in few.
    """
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(60, dimension)).astype(np.float32)

    def made_up(many: int) -> Vectors:
        vectors = rng.normal(size=(many, 60)).astype(np.float32) @ directions
        return vectors + rng.normal(size=vectors.shape).astype(np.float32)

    index = FaissIndex(dimension)
    for start in range(0, count, 4096):
        rows = range(start, min(start + 4096, count))
        entries = [IndexEntry(row, row // 500, row % 500, np.array([10.0 * row, 0.0, 0.0])) for row in rows]
        index.add(entries, made_up(len(rows)))
    queries, only = made_up(SEARCHES), SearchFilter(of_session=0, without=frozenset(range(201, 300)))

    def work() -> None:
        for query in queries:
            index.search(query, 20, only)

    return work


def _query(query: DescribedPlace, candidates: list[DescribedPlace], config: PipelineConfig) -> Work:
    pairs = [(one.place, query.descriptor.similarity(one.descriptor)) for one in candidates]

    def work() -> None:
        for place, similarity in pairs:
            verify(query.place, place, similarity, config.verification)

    return work


def _registration(visits: Visits, T_match_query: se3.Matrix4) -> Work:
    import small_gicp

    target, source = (submap.levelled().points.astype(np.float64) for submap in (visits.place, visits.revisit))
    return lambda: small_gicp.align(
        target, source, T_match_query, downsampling_resolution=_VOXEL_M, max_correspondence_distance=1.0, num_threads=1
    )


def _later(work: Callable[[Vectors], object], points: Vectors) -> Work:
    return lambda: work(points)
