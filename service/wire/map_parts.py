"""Views of tiles and files of maps to the fields of their messages; see `service.wire.answers`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.service.application.catalogue.downloads import DownloadKind
from revisit.service.application.contract import limits
from revisit.service.application.contract.map_tiles import TileKey
from revisit.service.application.mapping.map_files import MapFileView
from revisit.service.application.mapping.tiles import MapDistances, MapPoints, MapQuestion, MapTileView
from revisit.service.wire import names
from revisit.service.wire.answers import Fields, vector_fields
from revisit.v1 import geometry_pb2, map_tile_pb2

_DOWNLOADS: dict[int, tuple[DownloadKind, str | None]] = {
    map_tile_pb2.DownloadMapTileRequest.PCD: (DownloadKind.POINTS, "pcd"),
    map_tile_pb2.DownloadMapTileRequest.PLY: (DownloadKind.POINTS, "ply"),
    map_tile_pb2.DownloadMapTileRequest.NPY: (DownloadKind.POINTS, "npy"),
    map_tile_pb2.DownloadMapTileRequest.MESH: (DownloadKind.MESH, "ply"),
    map_tile_pb2.DownloadMapTileRequest.NEURAL: (DownloadKind.NEURAL, None),
    map_tile_pb2.DownloadMapTileRequest.GLB: (DownloadKind.MESH, "glb"),
}


def of_map_tile(view: MapTileView) -> Fields:
    """The fields of a MapTile."""
    return {
        "name": view.key.name,
        "frame": view.key.frame,
        "min_x_m": view.lower_m[0],
        "min_y_m": view.lower_m[1],
        "max_x_m": view.upper_m[0],
        "max_y_m": view.upper_m[1],
        "submaps": view.submaps,
        "made": view.made,
    }


def of_map_distances(view: MapDistances) -> Fields:
    """The fields of a MeasureMapDistancesResponse."""
    pairs = zip(view.distance_m, view.nearest_m, strict=True)
    distances = [{"distance_m": distance, "nearest_m": nearest} for distance, nearest in pairs]
    return {"map_version": view.version, "frame": view.frame, "distances": distances}


def of_map_points(view: MapPoints) -> Fields:
    """The fields of a FindMapPointsResponse."""
    pairs = zip(view.positions.tolist(), view.normals.tolist(), strict=True)
    points = [{"position_m": vector_fields(point), "normal": vector_fields(normal)} for point, normal in pairs]
    return {"map_version": view.version, "frame": view.frame, "points": points, "total": view.total}


def of_map_file(view: MapFileView) -> Fields:
    """The fields of a MapFile."""
    name = f"maps/{view.map_id}/files/{view.version}"
    return {
        "name": name,
        "map_id": view.map_id,
        "map_version": str(view.version),
        "map_status": view.state.value,
        "map_descriptor": view.description,
        "map_download_link": f"/v1/{name}:download",
        "map_hash": view.sha256,
        "size_bytes": view.size_bytes,
        "submaps": view.submaps,
        "created_at_ns": view.created_at_ns,
    }


def tile_key(name: str, field: str = "name") -> TileKey:
    """Of `maps/{map}/versions/{version}/tiles/{tile}`. Raises BadField."""
    map_id, version, tile = names.segments(name, "maps/*/versions/*/tiles/*", field)
    return TileKey.of(map_id, names.version_number(version, field), tile)


def file_key(name: str, field: str = "name") -> tuple[str, int]:
    """Map id and version of `maps/{map}/files/{version}`. Raises BadField."""
    map_id, version = names.segments(name, "maps/*/files/*", field)
    return map_id, names.version_number(version, field)


def tile_download(request: map_tile_pb2.DownloadMapTileRequest) -> tuple[DownloadKind, str | None]:
    """What to download of a tile. Raises BadField."""
    if request.format not in _DOWNLOADS:
        raise BadField("unknown download format", field="format")
    return _DOWNLOADS[request.format]


def distances(request: map_tile_pb2.MeasureMapDistancesRequest) -> MapQuestion:
    """The points whose distances are asked. Raises BadField."""
    if len(request.points_m) > limits.DISTANCE_POINTS.most:
        raise BadField(f"points_m must hold {limits.DISTANCE_POINTS} points", field="points_m")
    map_id, version = names.version_key(request.parent, "parent")
    points = np.array([[one.x, one.y, one.z] for one in request.points_m], dtype=np.float64).reshape(-1, 3)
    return MapQuestion(map_id, version, request.frame, points)


def points_around(request: map_tile_pb2.FindMapPointsRequest) -> MapQuestion:
    """The point around which the surface is asked. Raises BadField."""
    map_id, version = names.version_key(request.parent, "parent")
    limit = request.limit or MapQuestion.limit
    return MapQuestion(map_id, version, request.frame, _row(request.centre_m), request.within_m, limit)


def _row(point: geometry_pb2.Vector3) -> NDArray[np.float64]:
    return np.array([[point.x, point.y, point.z]])
