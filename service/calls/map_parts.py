"""Tiles of a map, questions to its surface, and its files."""

from __future__ import annotations

from collections.abc import AsyncIterator

import numpy as np

from revisit.core.codec.map_layout import PIECE_BYTES
from revisit.core.errors import BadField
from revisit.service.domain import limits
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import MapFileRecord
from revisit.service.features.tiles.calls import MapDistances, MapPoints, MapQuestion, MapTileView
from revisit.service.use_cases import UseCases
from revisit.service.wire import names, requests
from revisit.service.wire.fields import Fields, fields_of, vector_fields
from revisit.service.wire.rendering import Answer
from revisit.v1 import map_file_pb2, map_tile_pb2


async def download_map_tile(
    cases: UseCases, tenant: TenantId, request: map_tile_pb2.DownloadMapTileRequest
) -> AsyncIterator[Fields]:
    """A file in chunks; the first one has its type."""
    key = names.tile_key(request.name, moment=requests.moment(request))
    what = requests.tile_download(request.format)
    await cases.map_tiles.make(tenant, key)
    with cases.budget.hold(tenant) as held:
        file = await cases.map_tiles.download(tenant, key, *what, room=held.wait_for)
        held.set(len(file.data))
        for chunk in requests.chunks(file):
            yield chunk


async def measure_map_distances(
    cases: UseCases, tenant: TenantId, request: map_tile_pb2.MeasureMapDistancesRequest
) -> Answer:
    """Signed distances of points to the surface."""
    if len(request.points_m) > limits.DISTANCE_POINTS.most:
        raise BadField(f"points_m must hold {limits.DISTANCE_POINTS} points", field="points_m")
    points = np.array([[one.x, one.y, one.z] for one in request.points_m], dtype=np.float64).reshape(-1, 3)
    question = MapQuestion(
        *names.version_key(request.parent, "parent"), request.frame, points, moment=requests.moment(request)
    )
    return distance_fields(await cases.map_tiles.distances(tenant, question))


async def find_map_points(cases: UseCases, tenant: TenantId, request: map_tile_pb2.FindMapPointsRequest) -> Answer:
    """The points of the surface around one."""
    key, centre = names.version_key(request.parent, "parent"), request.centre_m
    around = np.array([[centre.x, centre.y, centre.z]])
    limit, moment = request.limit or MapQuestion.limit, requests.moment(request)
    question = MapQuestion(*key, request.frame, around, request.within_m, limit, moment)
    return point_fields(await cases.map_tiles.points(tenant, question))


async def download_map_file(
    cases: UseCases, tenant: TenantId, request: map_file_pb2.DownloadMapFileRequest
) -> AsyncIterator[Fields]:
    """A file, or a part of it, in chunks."""
    file = await cases.map_files.open(tenant, *names.file_key(request.name))
    if request.offset > file.layout.size:
        raise BadField(f"the file has {file.layout.size} bytes", field="offset")
    end = request.offset + request.length if request.length else file.layout.size
    with cases.budget.hold(tenant) as held:
        await held.wait_for(PIECE_BYTES)
        yield {"map_hash": file.record.sha256, "size_bytes": file.layout.size}
        async for piece in file.pieces(request.offset, end):
            yield {"data": piece}


def tile_fields(view: MapTileView) -> Fields:
    """The fields of a MapTile."""
    lower, upper = view.lower_m, view.upper_m
    corners = {"min_x_m": lower[0], "min_y_m": lower[1], "max_x_m": upper[0], "max_y_m": upper[1]}
    return fields_of(map_tile_pb2.MapTile, view, name=view.key.name, frame=view.key.frame, **corners)


def distance_fields(view: MapDistances) -> Fields:
    """The fields of a MeasureMapDistancesResponse."""
    pairs = zip(view.distance_m, view.nearest_m, strict=True)
    distances = [{"distance_m": distance, "nearest_m": nearest} for distance, nearest in pairs]
    return {"map_version": view.version, "frame": view.frame, "distances": distances}


def point_fields(view: MapPoints) -> Fields:
    """The fields of a FindMapPointsResponse."""
    pairs = zip(view.positions.tolist(), view.normals.tolist(), strict=True)
    points = [{"position_m": vector_fields(point), "normal": vector_fields(normal)} for point, normal in pairs]
    return {"map_version": view.version, "frame": view.frame, "points": points, "total": view.total}


def file_fields(record: MapFileRecord) -> Fields:
    """The fields of a MapFile."""
    name = f"maps/{record.map_id}/files/{record.version}"
    return fields_of(
        map_file_pb2.MapFile,
        record,
        name=name,
        map_version=str(record.version),
        map_status=record.state,
        map_descriptor=record.description,
        map_download_link=f"/v1/{name}:download",
        map_hash=record.sha256,
    )
