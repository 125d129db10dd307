"""`/v1/maps/{map}/versions/{version}/tiles`, `:distances` and `/points`."""

from __future__ import annotations

from enum import StrEnum
from functools import partial
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Query, Response
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.service.application.access.callers import Scope
from revisit.service.application.catalogue.downloads import MEDIA_TYPES, DownloadKind
from revisit.service.application.contract import limits
from revisit.service.application.contract.map_tiles import TileKey
from revisit.service.application.mapping.tiles import MapQuestion
from revisit.service.rest.access import allows
from revisit.service.rest.answers import MapDistances, MapPoints, MapTilePage, answer, answers, page_answer
from revisit.service.rest.bodies import ANY_BINARY, describe_json, json_body, parse_numbers
from revisit.service.rest.files import FileInPieces
from revisit.service.rest.parameters import Cases, Id, Paging, Tenant
from revisit.service.rest.schemas import IN_DIGITS, MeasureMapDistancesRequest, bounds
from revisit.service.wire import names
from revisit.service.wire.map_parts import of_map_distances, of_map_points, of_map_tile


def rows_of(coordinates: list[float], field: str) -> NDArray[np.float64]:
    """Points (n, 3) of their coordinates one after the other. Raises BadField for other numbers of them."""
    if len(coordinates) % 3:
        raise BadField(f"{field} must hold x, y and z of each point", field=field)
    return np.array(coordinates, dtype=np.float64).reshape(-1, 3)


router = APIRouter(prefix="/v1/maps/{map_id}/versions/{version_id}", tags=["tiles"])


class TileFormat(StrEnum):
    """Points as pcd, ply or npy; the surface as a ply mesh or as glb with meshopt; the neural map."""

    PCD = "pcd"
    PLY = "ply"
    NPY = "npy"
    MESH = "mesh"
    GLB = "glb"
    NEURAL = "neural"

    def what(self) -> tuple[DownloadKind, str | None]:
        """What the use case takes: the kind, and the file format where there is a choice."""
        if self in (TileFormat.PCD, TileFormat.PLY, TileFormat.NPY):
            return DownloadKind.POINTS, self.value
        if self is TileFormat.NEURAL:
            return DownloadKind.NEURAL, None
        return DownloadKind.MESH, "glb" if self is TileFormat.GLB else "ply"


@router.get("/tiles", **answers(MapTilePage), dependencies=[allows(Scope.INGEST, Scope.QUERY)])
async def list_map_tiles(map_id: Id, version_id: Id, cases: Cases, tenant: Tenant, paging: Paging) -> Response:
    """List the tiles that submaps of a version may reach into, by frame, column and row."""
    page = await cases.map_tiles.list(tenant, map_id, names.version_number(version_id), paging)
    return await page_answer(MapTilePage, "map_tiles", page, of_map_tile)


@router.get(
    "/tiles/{tile_id}:download",
    response_class=Response,
    responses={200: {"content": dict.fromkeys(MEDIA_TYPES.values(), ANY_BINARY), "description": "The file"}},
    dependencies=[allows(Scope.QUERY)],
)
async def download_map_tile(
    map_id: Id,
    version_id: Id,
    tile_id: Id,
    cases: Cases,
    tenant: Tenant,
    file_format: Annotated[TileFormat, Query(alias="format")],
) -> Response:
    """Download the surface of a tile as a file; a worker makes it when it is asked for first."""
    key, what = TileKey.of(map_id, names.version_number(version_id), tile_id), file_format.what()
    await cases.map_tiles.make(tenant, key)
    return FileInPieces(cases.budget, tenant, partial(cases.map_tiles.download, tenant, key, *what))


@router.post(
    ":distances",
    **answers(MapDistances),
    openapi_extra=describe_json(MeasureMapDistancesRequest),
    dependencies=[allows(Scope.QUERY)],
)
async def measure_map_distances(
    map_id: Id,
    version_id: Id,
    body: Annotated[MeasureMapDistancesRequest, json_body(MeasureMapDistancesRequest)],
    cases: Cases,
    tenant: Tenant,
) -> Response:
    """Signed distances of points to the surface of a version of a map."""
    points = rows_of(body.points_m, "points_m")
    question = MapQuestion(map_id, names.version_number(version_id), body.frame, points)
    return answer(MapDistances, of_map_distances(await cases.map_tiles.distances(tenant, question)))


@router.get("/points", **answers(MapPoints), dependencies=[allows(Scope.QUERY)])
async def find_map_points(
    map_id: Id,
    version_id: Id,
    cases: Cases,
    tenant: Tenant,
    centre_m: Annotated[str, Query(description="x,y,z in metres", max_length=200)],
    within_m: Annotated[float, Query(**bounds(limits.MAP_RADIUS_M))],
    frame: Annotated[str, Query(max_length=limits.ID_CHARACTERS)] = "",
    limit: Annotated[int, Query(**bounds(limits.MAP_POINTS)), IN_DIGITS] = MapQuestion.limit,
) -> Response:
    """The points of the surface of a version of a map around one point."""
    centre = np.array([parse_numbers(centre_m, 3, "centre_m", "x,y,z")], dtype=np.float64)
    question = MapQuestion(map_id, names.version_number(version_id), frame, centre, within_m, limit)
    return answer(MapPoints, of_map_points(await cases.map_tiles.points(tenant, question)))
