"""The map as an occupancy grid for navigation: made of the version in force, and anew when there is another one."""

from __future__ import annotations

import logging
import threading
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import RevisitError
from revisit.core.geometry import se3
from revisit.core.geometry.tile_grid import TILE_VOXELS
from revisit.core.geometry.voxel_keys import first_rows, voxel_keys
from revisit.formats import npy
from revisit.formats.cloud import DEFAULT_LIMITS
from revisit.formats.occupancy_grid import GridOptions, OccupancyGrid, grid_of, without_gone
from revisit.sdk.client import Client
from revisit.sdk.errors import ApiError, NotFound
from revisit.sdk.resources import SubmapPose

log = logging.getLogger("revisit_bridge")

THIN_M = 0.1
"""Of a submap one point is kept in a cube of this edge."""


@dataclass(frozen=True)
class MapGrid:
    """The grid of a version of the map, in the frame `frame` of it."""

    version: int
    frame: str
    grid: OccupancyGrid

    def save(self, folder: Path, name: str) -> Path:
        """Write it as `map_server` loads it, NAME.pgm and NAME.yaml; the latter's path."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.pgm").write_bytes(self.grid.to_pgm())
        described = folder / f"{name}.yaml"
        described.write_text(self.grid.to_yaml(f"{name}.pgm"))
        return described


@dataclass(frozen=True)
class MapSurface:
    """Points (n, 3) of the surface of a version in one of its frames, one in a voxel of `voxel_m`."""

    points: NDArray[np.floating]
    voxel_m: float


class MapSource(Protocol):
    """Where submaps and their poses come from."""

    def version(self) -> int:
        """The version of the map in force, 0 before the first. Raises ApiError."""

    def poses(self, version: int) -> Sequence[SubmapPose]:
        """Where a version has its submaps. Raises ApiError."""

    def points(self, submap: str) -> NDArray[np.floating]:
        """The points (n, 3) of a submap in its own frame; none where none is kept. Raises ApiError, MalformedBody."""

    def surface(self, version: int, frame: str, *, ever: bool) -> MapSurface:
        """What the latest drive left, or all that was `ever` there. Raises ApiError, MalformedBody."""


@dataclass(frozen=True)
class ServiceMap:
    """The map of the service, by the SDK."""

    client: Client
    map_name: str

    def version(self) -> int:
        """See MapSource."""
        return next((one.version for one in self.client.versions.list(self.map_name) if one.in_force), 0)

    def poses(self, version: int) -> Sequence[SubmapPose]:
        """See MapSource."""
        return self.client.versions.poses(f"{self.map_name}/versions/{version}")

    def points(self, submap: str) -> NDArray[np.floating]:
        """See MapSource."""
        try:
            return npy.decode(self.client.submaps.download(submap, "npy"), DEFAULT_LIMITS).points
        except NotFound:
            if self.client.submaps.get(submap).kept_scans != "NONE":
                raise
            return np.zeros((0, 3), np.float32)

    def surface(self, version: int, frame: str, *, ever: bool) -> MapSurface:
        """See MapSource."""
        found, voxel_m = [np.zeros((0, 3), np.float32)], 0.0
        for tile in self.client.versions.tiles(f"{self.map_name}/versions/{version}"):
            if tile.frame == frame:
                voxel_m = (tile.max_m[0] - tile.min_m[0]) / TILE_VOXELS
                file = self.client.versions.download_tile(tile, "npy", ever=ever)
                found.append(npy.decode(file, DEFAULT_LIMITS).points)
        return MapSurface(np.concatenate(found), voxel_m)


@dataclass
class MapGrids:
    """Makes grids in a thread of its own. Each submap is downloaded once, and kept thinned.

    An obstacle that a later drive looked through is left out, unless `ever`.
    """

    source: MapSource
    resolution_m: float
    ever: bool = False
    _made: MapGrid | None = None
    _told: int = 0
    _points: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    _thread: threading.Thread | None = None
    _closing: threading.Event = field(default_factory=threading.Event)

    @property
    def made(self) -> MapGrid | None:
        """The newest grid; None before the first."""
        return self._made

    def follow(self, session: str) -> None:
        """Look for a new version, unless that is being done; `session` is the robot's own, whose frame is taken."""
        if self.resolution_m > 0.0 and (self._thread is None or not self._thread.is_alive()):
            self._thread = threading.Thread(target=self._follow, args=(session,), name="revisit map", daemon=True)
            self._thread.start()

    def news(self) -> MapGrid | None:
        """The newest grid, if it was not told yet."""
        made = self._made
        if made is None or made.version == self._told:
            return None
        self._told = made.version
        return made

    def close(self) -> None:
        """Stop."""
        self._closing.set()
        if self._thread is not None:
            self._thread.join(timeout=5.0)

    def _follow(self, session: str) -> None:
        try:
            version = self.source.version()
            if version and (self._made is None or self._made.version != version):
                self._make(version, session)
        except (ApiError, RevisitError) as error:
            log.warning("no grid of the map: %s", error.message)

    def _make(self, version: int, session: str) -> None:
        poses = list(self.source.poses(version))
        frame = _frame(poses, session)
        placed = [pose for pose in poses if pose.frame == frame]
        clouds = []
        for pose in placed:
            if self._closing.is_set():
                return
            clouds.append(se3.apply(pose.T_map_submap, self._cloud(pose.submap)))
        self._points = {pose.submap: self._points[pose.submap] for pose in placed}
        sessions = [
            pose.submap.partition("/submaps/")[0] for pose, cloud in zip(placed, clouds, strict=True) if len(cloud)
        ]
        clouds = [cloud for cloud in clouds if len(cloud)]
        if clouds:
            grid = self._grid(clouds)
            if len(set(sessions)) > 1 and not self.ever:
                newest = self._grid([cloud for cloud, of in zip(clouds, sessions, strict=True) if of == sessions[-1]])
                grid = self._of_now(grid, newest, version, frame)
            self._made = MapGrid(version, frame, grid)

    def _grid(self, clouds: Sequence[NDArray[np.float64]]) -> OccupancyGrid:
        return grid_of(np.concatenate(clouds), GridOptions(resolution_m=self.resolution_m))

    def _of_now(self, grid: OccupancyGrid, newest: OccupancyGrid, version: int, frame: str) -> OccupancyGrid:
        """A grid without what is gone; as it is where the service does not tell that, or its map is too large."""
        try:
            now, ever = (self.source.surface(version, frame, ever=ever) for ever in (False, True))
            return without_gone(grid, newest, ever.points, now.points, now.voxel_m)
        except (ApiError, RevisitError) as error:
            log.warning("the grid of version %d keeps what may be gone: %s", version, error.message)
            return grid

    def _cloud(self, submap: str) -> NDArray[np.float64]:
        if submap not in self._points:
            points = np.asarray(self.source.points(submap), dtype=np.float64)
            cubes = np.floor(points / THIN_M).astype(np.int64)
            self._points[submap] = points[np.sort(first_rows(voxel_keys(cubes)))]
        return self._points[submap]


def _frame(poses: Sequence[SubmapPose], session: str) -> str:
    """The frame of the robot's own session; where no version has it, that of most submaps."""
    own = next((pose.frame for pose in poses if pose.submap.startswith(f"{session}/")), "") if session else ""
    return own or next((frame for frame, _ in Counter(pose.frame for pose in poses).most_common(1)), "")
