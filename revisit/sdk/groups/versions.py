"""Versions of a map: poses, tiles, and questions to the surface."""

from __future__ import annotations

import builtins
from typing import Any

import numpy as np

from revisit.sdk import names
from revisit.sdk.groups.group import MAX_PAGE, Group
from revisit.sdk.messages import request_of, vector
from revisit.sdk.names import name_of
from revisit.sdk.resources import Map, MapChange, MapDistances, MapPoints, MapTile, MapVersion, SubmapPose
from revisit.v1 import map_tile_pb2


class Versions(Group):
    """`client.versions`. Where a map is given, its version in force is meant.

    A surface is the one that the latest drive left: what it looked through is no longer there. With `as_of_ns` only
    what was seen up to then counts, nanoseconds since 1970; with `ever` everything that was ever there is.
    """

    def list(self, map_: str | Map) -> builtins.list[MapVersion]:
        """The versions of a map that are kept, oldest first."""
        return self._list(MapVersion, "ListMapVersions", parent=name_of(map_, names.MAP))

    def get(self, name: str) -> MapVersion:
        """Get `maps/{map}/versions/{version}`."""
        return MapVersion.of(self._ask("GetMapVersion", name=name_of(name, names.VERSION)))

    def poses(self, version: str | MapVersion) -> builtins.list[SubmapPose]:
        """The poses of the submaps in a version of a map, by session and in the order of their drive."""
        return self._list(SubmapPose, "ListSubmapPoses", parent=name_of(version, names.VERSION), page_size=MAX_PAGE)

    def tiles(self, version: str | Map | MapVersion) -> builtins.list[MapTile]:
        """The tiles that submaps of a version may reach into."""
        return self._list(MapTile, "ListMapTiles", parent=self.name(version), page_size=MAX_PAGE)

    def download_tile(
        self, tile: str | MapTile, file_format: str = "glb", *, as_of_ns: int | None = None, ever: bool = False
    ) -> bytes:
        """The surface of a tile in the map: `glb` or `mesh` (ply); points as pcd, ply or npy; `neural`.

        A worker makes it when it is asked for first. Raises DeadlineExceeded (NO_ANSWER) where that takes long.
        """
        asked = {"name": name_of(tile, names.TILE), "format": file_format.upper(), "as_of_ns": as_of_ns, "ever": ever}
        return self._transport.download("DownloadMapTile", request_of(map_tile_pb2.DownloadMapTileRequest, asked))

    def distances(
        self,
        version: str | Map | MapVersion,
        points_m: Any,
        *,
        frame: str = "",
        as_of_ns: int | None = None,
        ever: bool = False,
    ) -> MapDistances:
        """Signed distances of up to 1000 points (n, 3) to the surface of a map, in one of its frames ("": the only)."""
        rows = np.asarray(points_m, dtype=np.float64).reshape(-1, 3).tolist()
        points = [{"x": x, "y": y, "z": z} for x, y, z in rows]
        moment = {"as_of_ns": as_of_ns, "ever": ever}
        found = self._ask("MeasureMapDistances", parent=self.name(version), frame=frame, points_m=points, **moment)
        return MapDistances.of(found)

    def points(
        self,
        version: str | Map | MapVersion,
        centre_m: Any,
        within_m: float,
        *,
        frame: str = "",
        limit: int = 1000,
        as_of_ns: int | None = None,
        ever: bool = False,
    ) -> MapPoints:
        """The points of the surface of a map within a radius of one point, the nearest first."""
        asked = {"parent": self.name(version), "centre_m": vector(centre_m), "within_m": within_m, "frame": frame}
        return MapPoints.of(self._ask("FindMapPoints", **asked, limit=limit, as_of_ns=as_of_ns, ever=ever))

    def changes(
        self, version: str | Map | MapVersion, *, after_ns: int = 0, until_ns: int = 0
    ) -> builtins.list[MapChange]:
        """What drives found changed after one moment, up to another (0: to the end), in the order of time.

        A worker compares them when this is asked for first. Raises DeadlineExceeded (NO_ANSWER) until it has.
        """
        moments = {"after_ns": after_ns, "until_ns": until_ns}
        return self._list(MapChange, "ListMapChanges", parent=self.name(version), page_size=MAX_PAGE, **moments)

    def name(self, version: str | Map | MapVersion) -> str:
        """The name of a version; of a map, that of the one in force."""
        name = name_of(version, names.MAP)
        if name.count("/") != 1:
            return name
        return f"{name}/versions/{self._ask('GetMap', name=name).map_version}"
