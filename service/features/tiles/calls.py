"""A version of a map piece by piece: its tiles, their surfaces as files, distances to the surface, points around one.

Tiles are made by a worker when somebody asks for them for the first time, and kept.
"""

from __future__ import annotations

import asyncio
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.service.capacity.charged_work import ChargedWork
from revisit.service.domain import limits
from revisit.service.domain.errors import NoAnswer
from revisit.service.domain.identity import TenantId
from revisit.service.domain.policy import Policy
from revisit.service.domain.states import OperationKind
from revisit.service.features.catalogue.downloads import (
    RENDERING_BYTES,
    Download,
    DownloadKind,
    Room,
    any_room,
)
from revisit.service.features.operations.calls import Operations
from revisit.service.features.operations.joined_jobs import JoinedJobs
from revisit.service.features.resources.call_context import CallContext
from revisit.service.features.resources.paging import Page, PageRequest, as_it_is
from revisit.service.features.tiles.files import render_tile
from revisit.service.features.tiles.rows import Tiling, found_tile, read_tiling
from revisit.service.ports.blobs import TILE_BLOB
from revisit.service.ports.map_tiles import NOW, Moment, TileKey, stored_tile
from revisit.service.ports.transactions import UnitOfWork


@dataclass(frozen=True)
class MapTileView:
    """A tile: its square in the frame, (x, y) metres; how many submaps may reach into it; whether it was made."""

    key: TileKey
    lower_m: tuple[float, float]
    upper_m: tuple[float, float]
    submaps: int
    made: bool
    number: int


@dataclass(frozen=True)
class MapDistances:
    """Signed distances of points to the surface, and to the nearest neural point, metres; None: nothing is known."""

    map_id: str
    version: int
    frame: str
    distance_m: tuple[float | None, ...]
    nearest_m: tuple[float | None, ...]


@dataclass(frozen=True)
class MapPoints:
    """Points (n, 3) of the surface around one, with normals (n, 3), the nearest first; `total` there are in all."""

    map_id: str
    version: int
    frame: str
    positions: NDArray[np.float64]
    normals: NDArray[np.float64]
    total: int


@dataclass(frozen=True)
class MapQuestion:
    """A query of a map's version, in one of its frames ("": the only one): points (n, 3) in metres.

    With `within_m` there is one point, and at most `limit` points of the surface around it are the answer.
    """

    map_id: str
    version: int
    frame: str
    points_m: NDArray[np.float64]
    within_m: float | None = None
    limit: int = 1000
    moment: Moment = NOW


class MapTiles:
    """List, download, measure."""

    def __init__(self, context: CallContext, operations: Operations, work: ChargedWork) -> None:
        """Tiles are made by jobs: `operations` waits for them, `work` makes their files."""
        self._context = context
        self._jobs = JoinedJobs(context, operations)
        self._work = work

    async def list(self, tenant: TenantId, map_id: str, version: int, page: PageRequest) -> Page[MapTileView]:
        """The tiles that submaps may reach into, by frame, column and row. Raises NotFound."""
        find = partial(_tiles, policy=self._context.policy, tenant=tenant, map_id=map_id, version=version)
        return await self._context.lists.page(tenant, page, find, as_it_is)

    async def make(self, tenant: TenantId, key: TileKey) -> None:
        """Wait until a tile is there: a download then holds no slot meanwhile. Raises as `download`."""
        await self._made(tenant, key)

    async def download(
        self,
        tenant: TenantId,
        key: TileKey,
        kind: DownloadKind,
        file_format: str | None = None,
        room: Room = any_room,
    ) -> Download:
        """The surface of a tile as a file, in the frame of the map: mesh ply or glb; points pcd, ply or npy; neural.

        It is read and rendered when `room` has room.

        Raises NotFound, NoAnswer where no worker made it in time, UnsupportedEncoding, DataLoss, RateLimited, and
        errors of the method.
        """
        sha256 = await self._made(tenant, key)
        await room(RENDERING_BYTES)
        blob = await asyncio.to_thread(self._context.storage.blobs.get, tenant, TILE_BLOB, sha256)
        return await self._work.of(tenant, partial(render_tile, blob, key, kind, file_format))

    async def distances(self, tenant: TenantId, question: MapQuestion) -> MapDistances:
        """Signed distances of points to the surface. Raises BadField, NotFound, NoAnswer, errors of the method."""
        if not 1 <= len(question.points_m) <= limits.DISTANCE_POINTS.most:
            raise BadField(f"points_m must hold {limits.DISTANCE_POINTS} points", field="points_m")
        result = await self._measured(tenant, question)
        distance, nearest = tuple(result["distance_m"]), tuple(result["nearest_m"])
        return MapDistances(question.map_id, question.version, result["frame"], distance, nearest)

    async def points(self, tenant: TenantId, question: MapQuestion) -> MapPoints:
        """The points of the surface around one. Raises as `distances`."""
        limits.MAP_RADIUS_M.validated(question.within_m or 0.0, "within_m")
        limits.MAP_POINTS.validated(question.limit, "limit")
        result = await self._measured(tenant, question)
        rows = np.array(result["points"], dtype=np.float64).reshape(-1, 6)
        found = (rows[:, :3], rows[:, 3:], result["total"])
        return MapPoints(question.map_id, question.version, result["frame"], *found)

    async def _made(self, tenant: TenantId, key: TileKey) -> str:
        """The hash of the blob of a tile, made by a worker where it is missing."""
        key, sha256 = await self._found(tenant, key)
        if sha256 is None:
            payload = {"map_id": key.map_id, "version": key.version, "tile": key.tile_id, **asdict(key.moment)}
            await self._jobs.answer(tenant, OperationKind.MAKE_TILE, key.name, payload)
            sha256 = await self._context.storage.read(partial(stored_tile, tenant=tenant, key=key))
        if sha256 is None:
            raise NoAnswer("the tile was deleted while it was made; ask again")
        return sha256

    async def _found(self, tenant: TenantId, key: TileKey) -> tuple[TileKey, str | None]:
        """As `found_tile`. Where submaps are read for it, which may be thousands, that is charged."""
        if key.moment.as_of_ns is None:
            sha256 = await self._context.storage.read(partial(stored_tile, tenant=tenant, key=key))
            if sha256 is not None:
                return key, sha256
        find = partial(found_tile, policy=self._context.policy, tenant=tenant, key=key)
        return await self._work.of(tenant, partial(self._context.storage.transactions.read_here, find))

    async def _measured(self, tenant: TenantId, question: MapQuestion) -> dict[str, Any]:
        points = question.points_m
        if not np.isfinite(points).all() or np.abs(points).max(initial=0.0) > limits.PRIOR_COORDINATE_M.most:
            raise BadField(f"coordinates must be in {limits.PRIOR_COORDINATE_M}", field="points_m")
        read = partial(
            read_tiling, policy=self._context.policy, tenant=tenant, map_id=question.map_id, version=question.version
        )
        tiling = await self._context.storage.read(read)
        frame = tiling.frame(question.frame).frame
        _require_few_tiles(tiling, question)
        payload = {
            "map_id": question.map_id, "version": question.version, "frame": frame, "points_m": points.tolist(),
            "within_m": question.within_m, "limit": question.limit, **asdict(question.moment),
        }  # fmt: skip
        subject = f"maps/{question.map_id}/versions/{question.version}"
        return await self._jobs.answer(tenant, OperationKind.MEASURE_MAP, subject, payload)


def _tiles(
    uow: UnitOfWork, after: int, limit: int, *, policy: Policy, tenant: TenantId, map_id: str, version: int
) -> list[MapTileView]:
    tiling = read_tiling(uow, policy, tenant, map_id, version)
    made = uow.map_tiles.distinct(tenant, "tile_id", map_id=map_id, version=version)
    shown = tiling.tiles()[after : after + limit]
    return [
        MapTileView(key, *tiling.grid.bounds(key.cell), submaps, key.stored_id in made, number)
        for number, (key, submaps) in enumerate(shown, after + 1)
    ]


def _require_few_tiles(tiling: Tiling, question: MapQuestion) -> None:
    """Raises BadField where an answer would rest on too many tiles."""
    cells = set(tiling.grid.cells(question.points_m))
    if question.within_m is not None:
        cells = set(tiling.grid.reached(question.points_m[:1], question.within_m))
    if len(cells) > limits.QUERY_TILES:
        edge_m, most = tiling.grid.edge_m, limits.QUERY_TILES
        raise BadField(
            f"the question reaches {len(cells)} tiles of {edge_m:g} m, at most {most} at once", field="points_m"
        )
