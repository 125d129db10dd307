"""The tiles of a version of a map, and the sources of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import PipelineConfig
from revisit.core.geometry.tile_grid import TileGrid
from revisit.core.merge.evidence import SHOWN_STRIDES, in_time, lost_views
from revisit.service.domain.errors import NotFound, NotKept
from revisit.service.domain.identity import TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.records import SessionPosesRecord, SubmapRecord
from revisit.service.features.graph.released_maps import released_maps
from revisit.service.features.graph.session_poses import PackedSubmaps
from revisit.service.ports.map_merger import PlacedSubmapMap
from revisit.service.ports.map_tiles import TileKey, stored_tile
from revisit.service.ports.storage import require_map
from revisit.service.ports.transactions import UnitOfWork

MOST_SUBMAPS = 128
"""That a tile is made of. Of a place that was driven more often these are the latest (`_latest`)."""

_PLACES = 5
"""Along an edge of a tile: so large is a place, at which the latest submaps come first."""

_NUMBERED_AT_ONCE = 1000


@dataclass(frozen=True)
class PlacedFrame:
    """The submaps of one frame of a version, by session and in the order of their drives: numbers (n,) and poses.

    `sessions` (n,) are the numbers of theirs.
    """

    frame: str
    numbers: NDArray[np.int64]
    T_map_submap: NDArray[np.float64]
    sessions: NDArray[np.int64]

    @property
    def positions(self) -> NDArray[np.float64]:
        """(n, 3), metres."""
        return np.asarray(self.T_map_submap[:, :3, 3])


@dataclass(frozen=True)
class PlannedMap:
    """A neural map by its hash, where its submap lies (16), the number of its session, and when it was taken."""

    sha256: str
    T_map_submap: tuple[float, ...]
    session: int
    stamp_ns: int

    def placed(self, *, dated: bool = True) -> PlacedSubmapMap:
        """As the method takes it; without its drive where drives are not told apart."""
        pose = np.reshape(self.T_map_submap, (4, 4))
        drive = (self.session, self.stamp_ns) if dated else ()
        return PlacedSubmapMap(self.sha256, pose, *drive)


@dataclass(frozen=True)
class TilePlan:
    """The sources of a tile: neural maps of submaps and where these lie in the frame; the middle of its square."""

    key: TileKey
    centre: tuple[float, float, float]
    placed: tuple[PlannedMap, ...]

    @property
    def centre_m(self) -> NDArray[np.float64]:
        """(3,), metres in the frame."""
        return np.array(self.centre)

    @property
    def maps(self) -> list[PlacedSubmapMap]:
        """As the method takes them; without their drives where nothing is to be left out."""
        return [one.placed(dated=not self.key.moment.ever) for one in self.placed]


@dataclass(frozen=True)
class Tiling:
    """The frames of a version of a map, and the grid over each of them.

    `stride_m` lies between two submaps of a drive; `released` are the numbers of those whose neural maps retention has
    removed.
    """

    map_id: str
    version: int
    grid: TileGrid
    reach_m: float
    frames: tuple[PlacedFrame, ...]
    stride_m: float
    released: frozenset[int]

    def is_of(self, other: Tiling) -> bool:
        """Whether both are of the same submaps: poses come from the version."""
        numbers = [[(one.frame, one.numbers.tolist()) for one in tiling.frames] for tiling in (self, other)]
        return numbers[0] == numbers[1]

    def tiles(self) -> list[tuple[TileKey, int]]:
        """Every tile that a submap with a neural map may reach into, with how many do, by frame, column and row."""
        return [
            (TileKey(self.map_id, self.version, one.frame, cell), len(rows))
            for one in self.frames
            for cell, rows in self.grid.reached(one.positions[~self.is_released(one)], self.reach_m).items()
        ]

    def frame(self, name: str) -> PlacedFrame:
        """The frame of this name; where it is empty, the only one. Raises NotFound."""
        found = [one for one in self.frames if one.frame == name or not name]
        if len(found) != 1:
            known = ", ".join(one.frame for one in self.frames)
            raise NotFound(f"version {self.version} of map {self.map_id} has the frames {known}: name one"[:200])
        return found[0]

    def reaching(self, key: TileKey) -> NDArray[np.int64]:
        """The submaps with a neural map of its frame that may reach into a tile, the nearest to its middle first."""
        rows = self.all_reaching(key)
        return rows[~self.is_released(self.frame(key.frame))[rows]] if len(rows) else rows

    def is_released(self, frame: PlacedFrame) -> NDArray[np.bool_]:
        """Which submaps of a frame have no neural map any more (n,)."""
        return np.isin(frame.numbers, list(self.released))

    def all_reaching(self, key: TileKey, beyond_m: float = 0.0) -> NDArray[np.int64]:
        """The same with those that have no neural map any more, and with such as are up to `beyond_m` farther away."""
        known = [one for one in self.frames if one.frame == key.frame]
        if not known:
            return np.zeros(0, np.int64)
        gaps = self.grid.distances_m(key.cell, known[0].positions)
        rows = np.flatnonzero(gaps <= self.reach_m + beyond_m)
        middle = np.linalg.norm(known[0].positions[rows, :2] - self.grid.centre(key.cell)[:2], axis=1)
        return np.asarray(rows[np.lexsort((rows, middle))])


def read_tiling(uow: UnitOfWork, policy: Policy, tenant: TenantId, map_id: str, version: int) -> Tiling:
    """The tiling of a version of a map. Raises NotFound."""
    record = require_map(uow, tenant, map_id)
    if uow.map_versions.get(tenant, map_id, min(version, record.map_version + 1)) is None:
        raise NotFound(f"there is no version {version} of map {map_id!r}"[:200])
    config = policy.for_map(record)
    rows = uow.session_poses.find(tenant, map_id=map_id, version=version)
    parts: dict[str, list[SessionPosesRecord]] = {}
    for row in sorted(rows, key=lambda poses: poses.session_number):
        parts.setdefault(row.frame, []).append(row)
    frames = tuple(_joined(name, parts[name]) for name in sorted(parts))
    reach_m = config.submap.surface_reach_m(config.scene_scale)
    released = released_maps(uow, tenant, map_id)
    return Tiling(map_id, version, grid_of(config), reach_m, frames, config.submap.stride, released)


def grid_of(config: PipelineConfig) -> TileGrid:
    """The grid of maps with these parameters."""
    return TileGrid.of(config.implicit_map.resolution, config.scene_scale)


def read_plan(uow: UnitOfWork, policy: Policy, tenant: TenantId, key: TileKey) -> TilePlan:
    """The sources of a tile.

    Raises NotFound for a version that is gone or a tile that no submap reaches, NotKept for a moment of which retention
    has left no view.
    """
    tiling = read_tiling(uow, policy, tenant, key.map_id, key.version)
    rows = tiling.reaching(key)
    if not len(rows) and len(tiling.all_reaching(key)):
        raise NotKept(f"the map's policy of retention has removed all neural maps that reach tile {key.tile_id!r}")
    if not len(rows):
        raise NotFound(f"there is no tile {key.tile_id!r} in version {key.version} of map {key.map_id!r}"[:200])
    x, y, z = tiling.grid.centre(key.cell).tolist()
    frame, moment = tiling.frame(key.frame), key.moment
    drives = len(set(frame.sessions[rows].tolist()))
    if moment.as_of_ns is not None:
        _require_kept(uow, tenant, tiling, key)
        rows, as_of_ns = _by_then(uow, tenant, frame, rows, moment.as_of_ns)
        moment = replace(moment, as_of_ns=as_of_ns)
    if not moment.ever and drives > 1 and len(rows) > MOST_SUBMAPS:
        rows = _latest(uow, tenant, frame, rows, tiling.grid.edge_m / _PLACES)
    return TilePlan(replace(key, moment=moment), (x, y, z), planned(uow, tenant, frame, rows))


def found_tile(uow: UnitOfWork, policy: Policy, tenant: TenantId, key: TileKey) -> tuple[TileKey, str | None]:
    """The key under which a tile is stored, and the hash of its blob; None where it was not made yet.

    Raises as `read_plan`.
    """
    key = read_plan(uow, policy, tenant, key).key
    return key, stored_tile(uow, tenant, key)


def _by_then(
    uow: UnitOfWork, tenant: TenantId, frame: PlacedFrame, rows: NDArray[np.int64], as_of_ns: int
) -> tuple[NDArray[np.int64], int | None]:
    """The submaps that were taken by a moment, and that of the last of them, None where these are all: in between
    nothing changes.

    So a tile has no more surfaces than submaps, whatever moments somebody asks for.
    """
    stamps_ns = _stamps_ns(uow, tenant, frame, rows)
    by_then = stamps_ns <= as_of_ns
    return rows[by_then], None if by_then.all() else int(stamps_ns[by_then].max(initial=0))


def _require_kept(uow: UnitOfWork, tenant: TenantId, tiling: Tiling, key: TileKey) -> None:
    """Raises NotKept where the map that showed a place last by the moment of a tile is gone."""
    frame, near_m = tiling.frame(key.frame), SHOWN_STRIDES * tiling.stride_m
    released = tiling.is_released(frame)
    if not released[tiling.all_reaching(key)].any():
        return
    rows = tiling.all_reaching(key, near_m)
    stamps_ns = _stamps_ns(uow, tenant, frame, rows)
    by_then = stamps_ns <= (key.moment.as_of_ns or 0)
    rows, stamps_ns = rows[by_then], stamps_ns[by_then]
    lost = lost_views(frame.positions[rows, :2], stamps_ns, released[rows], tiling.stride_m)
    if lost:
        raise NotKept(
            f"the map's policy of retention has removed {lost} neural maps of that moment that tile {key.tile_id!r} "
            "was made of"
        )


def _latest(
    uow: UnitOfWork, tenant: TenantId, frame: PlacedFrame, rows: NDArray[np.int64], edge_m: float
) -> NDArray[np.int64]:
    """Submaps of several drives, those first that fewest have followed at their place: what it was like is then told
    by the latest of them. Of those that as many followed the nearest to the middle comes first, as in `rows`.
    """
    stamps_ns = _stamps_ns(uow, tenant, frame, rows)
    times = [in_time(*one) for one in zip(frame.sessions[rows].tolist(), stamps_ns.tolist(), strict=True)]
    followed, seen = np.zeros(len(rows), np.int64), Counter[tuple[int, ...]]()
    places = np.floor(frame.positions[rows, :2] / edge_m).astype(np.int64).tolist()
    for number in sorted(range(len(rows)), key=lambda one: (times[one], one), reverse=True):
        place = tuple(places[number])
        followed[number] = seen[place]
        seen[place] += 1
    return np.asarray(rows[np.argsort(followed, kind="stable")])


def _stamps_ns(uow: UnitOfWork, tenant: TenantId, frame: PlacedFrame, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """When submaps were taken (n,); 0 of those that are gone."""
    numbers = frame.numbers[rows].tolist()
    known = submaps_numbered(uow, tenant, numbers)
    return np.array([known[one].stamp_ns if one in known else 0 for one in numbers], dtype=np.int64)


def planned(uow: UnitOfWork, tenant: TenantId, frame: PlacedFrame, rows: NDArray[np.int64]) -> tuple[PlannedMap, ...]:
    """The first MOST_SUBMAPS of some submaps of a frame, in the order of their drives."""
    rows = np.sort(rows[:MOST_SUBMAPS])
    known = submaps_numbered(uow, tenant, frame.numbers[rows].tolist())
    found = ((known.get(int(frame.numbers[row])), row) for row in rows.tolist())
    return tuple(
        PlannedMap(
            one.neural_map_sha256, tuple(frame.T_map_submap[row].ravel().tolist()), one.session_number, one.stamp_ns
        )
        for one, row in found
        if one is not None and one.neural_map_sha256 is not None
    )


def _joined(frame: str, rows: Sequence[SessionPosesRecord]) -> PlacedFrame:
    parts = [PackedSubmaps.of(row.submaps) for row in rows]
    numbers = np.concatenate([one.numbers for one in parts])
    sessions = np.repeat([row.session_number for row in rows], [len(one.numbers) for one in parts])
    return PlacedFrame(frame, numbers, np.concatenate([one.T_map_submap for one in parts]), sessions)


def submaps_numbered(uow: UnitOfWork, tenant: TenantId, numbers: Sequence[int]) -> dict[int, SubmapRecord]:
    """Any number of submaps by their numbers."""
    found: dict[int, SubmapRecord] = {}
    for start in range(0, len(numbers), _NUMBERED_AT_ONCE):
        found |= uow.submaps.numbered(tenant, numbers[start : start + _NUMBERED_AT_ONCE])
    return found
