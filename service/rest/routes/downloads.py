"""Routes that answer with a file: a submap, a tile of a map, a map."""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Header, Query, Response

from revisit.api.calls import CALLS
from revisit.service.domain import limits
from revisit.service.features.catalogue.downloads import MEDIA_TYPES
from revisit.service.ports.map_tiles import Moment, TileKey
from revisit.service.rest.access import served
from revisit.service.rest.bodies import ANY_BINARY
from revisit.service.rest.files import FileInPieces
from revisit.service.rest.parameters import Cases, Id, SubmapOf, Tenant
from revisit.service.rest.ranges import MAP_FILE, FileInRanges
from revisit.service.wire import names, requests
from revisit.v1 import map_tile_pb2, submap_pb2

router = APIRouter()

_FILE: dict[str, Any] = {
    "response_class": Response,
    "responses": {200: {"content": dict.fromkeys(MEDIA_TYPES.values(), ANY_BINARY), "description": "The file"}},
}
_RANGES: dict[str, Any] = {
    "response_class": Response,
    "responses": {
        200: {"content": {MAP_FILE: ANY_BINARY}, "description": "The file"},
        206: {"content": {MAP_FILE: ANY_BINARY}, "description": "The range that was asked for"},
        304: {"description": "The file is the one that `If-None-Match` names"},
        416: {"description": "The range begins behind the end of the file"},
    },
}

_OF_SUBMAP, _OF_TILE = submap_pb2.DownloadSubmapRequest.Format, map_tile_pb2.DownloadMapTileRequest.Format


def _format(enum: Any) -> Any:
    """The parameter `format` with the names of an enum in lower case."""
    names_of = tuple(name.lower() for name, number in enum.items() if number)
    return Annotated[Literal[names_of], Query(alias="format")]


def _number(enum: Any, name: str) -> int:
    return int(enum.Value(name.upper()))


SubmapFormat, TileFormat = _format(_OF_SUBMAP), _format(_OF_TILE)
AsOf = Annotated[int | None, Query(ge=limits.STAMP_NS.least, le=limits.STAMP_NS.most)]


@router.api_route(**served(CALLS["DownloadSubmap"]), **_FILE)
async def download_submap(
    key: SubmapOf,
    cases: Cases,
    tenant: Tenant,
    file_format: SubmapFormat,  # type: ignore[valid-type]  # made at run time
) -> Response:
    """Download a submap as a file."""
    kind, file_kind = requests.download(_number(_OF_SUBMAP, file_format))
    return FileInPieces(cases.budget, tenant, partial(cases.submaps.download, tenant, key, kind, file_kind))


@router.api_route(**served(CALLS["DownloadMapTile"]), **_FILE)
async def download_map_tile(
    map_id: Id,
    version_id: Id,
    tile_id: Id,
    cases: Cases,
    tenant: Tenant,
    file_format: TileFormat,  # type: ignore[valid-type]  # made at run time
    as_of_ns: AsOf = None,
    ever: bool = False,
) -> Response:
    """Download the surface of a tile as a file; a worker makes it when it is asked for first."""
    key = TileKey.of(map_id, names.version_number(version_id), tile_id, Moment(as_of_ns, ever))
    what = requests.tile_download(_number(_OF_TILE, file_format))
    await cases.map_tiles.make(tenant, key)
    return FileInPieces(cases.budget, tenant, partial(cases.map_tiles.download, tenant, key, *what))


@router.api_route(**served(CALLS["DownloadMapFile"]), **_RANGES)
async def download_map_file(
    map_id: Id,
    version_id: Id,
    cases: Cases,
    tenant: Tenant,
    byte_range: Annotated[str | None, Header(alias="Range", max_length=100)] = None,
    if_range: Annotated[str | None, Header(alias="If-Range", max_length=100)] = None,
    if_none_match: Annotated[str | None, Header(alias="If-None-Match", max_length=1000)] = None,
) -> Response:
    """Download a file, or one range of its bytes; its ETag is its hash."""
    file = await cases.map_files.open(tenant, map_id, names.version_number(version_id))
    return FileInRanges(cases.budget, tenant, file, byte_range, if_range, if_none_match)
