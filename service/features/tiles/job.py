"""Tiles of a map, made and measured by a worker."""

from __future__ import annotations

from collections import defaultdict
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.codec.tile import StoredTile, pack_tile
from revisit.core.geometry.tile_grid import Cell
from revisit.service.domain.errors import NotFound
from revisit.service.domain.identity import TenantId
from revisit.service.domain.records import MapTileRecord
from revisit.service.failpoints import failpoint
from revisit.service.features.deletion.blob_references import blob_of_tile
from revisit.service.features.operations.unchanged import unchanged
from revisit.service.features.tiles.rows import TilePlan, Tiling, read_plan, read_tiling
from revisit.service.ports.blobs import NEURAL_MAP_BLOB, TILE_BLOB
from revisit.service.ports.job_context import JobContext
from revisit.service.ports.job_queue import Lease
from revisit.service.ports.map_tiles import Moment, TileKey, TileMaker, stored_tile
from revisit.service.ports.transactions import UnitOfWork

MOST_STORED = 4096
"""Tiles of a map that are kept: 10 km of streets in two versions. The first that were made go first."""


class TileMaking:
    """Runs the jobs that make and measure tiles; all calls block."""

    def __init__(self, context: JobContext, maker: TileMaker) -> None:
        """`maker` is the method."""
        self._context = context
        self._maker = maker

    def make(self, lease: Lease) -> None:
        """Make and store a tile. Raises NotFound for one that is gone, and the errors of the method."""
        payload, tenant = lease.job.payload, lease.job.tenant
        key = TileKey.of(payload["map_id"], payload["version"], payload["tile"], moment_of(payload))
        self._tile(tenant, key)
        self._context.complete(lease, {"tile": key.name})

    def measure(self, lease: Lease) -> None:
        """Signed distances of points, or the points of the surface around one, as the payload asks."""
        payload, tenant = lease.job.payload, lease.job.tenant
        read = partial(
            read_tiling,
            policy=self._context.policy,
            tenant=tenant,
            map_id=payload["map_id"],
            version=payload["version"],
        )
        tiling = self._context.transactions.read(read).result()
        asked = np.array(payload["points_m"], dtype=np.float64).reshape(-1, 3)
        if payload["within_m"] is None:
            result = self._distances(tenant, tiling, payload, asked)
        else:
            result = self._around(tenant, tiling, payload, asked[0])
        self._context.complete(lease, {"frame": payload["frame"], "version": payload["version"], **result})

    def _distances(
        self, tenant: TenantId, tiling: Tiling, payload: dict[str, Any], points: NDArray[np.float64]
    ) -> dict[str, Any]:
        distance, nearest = np.full(len(points), np.nan), np.full(len(points), np.inf)
        rows_of: dict[TileKey, list[int]] = defaultdict(list)
        for row, cell in enumerate(tiling.grid.cells(points)):
            rows_of[_key(tiling, payload, cell)].append(row)
        for key, rows in sorted(rows_of.items(), key=lambda item: item[0].cell):
            tile = self._known(tenant, tiling, key)
            if tile is not None and tile.neural_map:
                distance[rows], nearest[rows] = self._maker.distances_m(tile.neural_map, points[rows])
        known = np.isfinite(nearest)
        return {
            "distance_m": [float(d) if there else None for d, there in zip(distance, known, strict=True)],
            "nearest_m": [float(d) if there else None for d, there in zip(nearest, known, strict=True)],
        }

    def _around(
        self, tenant: TenantId, tiling: Tiling, payload: dict[str, Any], centre: NDArray[np.float64]
    ) -> dict[str, Any]:
        """The points within a radius, the nearest first, at most as many as were asked for."""
        within_m, parts = float(payload["within_m"]), [np.zeros((0, 6))]
        for cell in tiling.grid.reached(centre[None], within_m):
            tile = self._known(tenant, tiling, _key(tiling, payload, cell))
            if tile is not None:
                points = tile.points
                parts.append(np.hstack([points.vertices + tile.centre_m, points.normals]))
        every = np.concatenate(parts)
        gaps = np.linalg.norm(every[:, :3] - centre, axis=1)
        within = np.flatnonzero(gaps <= within_m)
        nearest = within[np.argsort(gaps[within], kind="stable")[: int(payload["limit"])]]
        return {"points": every[nearest].round(4).tolist(), "total": len(within)}

    def _known(self, tenant: TenantId, tiling: Tiling, key: TileKey) -> StoredTile | None:
        """A tile, made where it is missing; None where no submap reaches it."""
        if not len(tiling.reaching(key)):
            return None
        return StoredTile(self._context.blobs.get(tenant, TILE_BLOB, self._tile(tenant, key)))

    def _tile(self, tenant: TenantId, key: TileKey) -> str:
        """The hash of a tile's blob, which is made and stored where it is missing."""
        message = "the submaps of the tile were changed again and again while it was made"
        return unchanged(partial(self._found_or_made, tenant, key), message)

    def _found_or_made(self, tenant: TenantId, key: TileKey) -> str:
        """The same; "" where its submaps have changed while it was made."""
        sha256, plan = self._context.transactions.read(partial(self._found, tenant=tenant, key=key)).result()
        return sha256 or self._made(tenant, plan)

    def _found(self, uow: UnitOfWork, tenant: TenantId, key: TileKey) -> tuple[str | None, TilePlan]:
        plan = read_plan(uow, self._context.policy, tenant, key)
        return stored_tile(uow, tenant, plan.key), plan

    def _made(self, tenant: TenantId, plan: TilePlan) -> str:
        """Make a tile and store it; "" where its submaps have changed meanwhile."""
        read = partial(self._context.blobs.get, tenant, NEURAL_MAP_BLOB)
        blob = pack_tile(self._maker.fuse(plan.maps, plan.centre_m, read), plan.centre_m)
        put = partial(self._context.blobs.put, tenant, TILE_BLOB, blob)
        sha256 = put()
        failpoint("tile.after_blob")
        commit = partial(self._stored, tenant=tenant, plan=plan, sha256=sha256)
        return sha256 if self._context.write_naming(commit, put) else ""

    def _stored(self, uow: UnitOfWork, tenant: TenantId, plan: TilePlan, sha256: str) -> bool:
        """Store the row of a tile if its submaps are unchanged."""
        key = plan.key
        uow.maps.get(tenant, key.map_id, hold=True)
        try:
            if read_plan(uow, self._context.policy, tenant, key) != plan:
                return False
        except NotFound:
            return False
        if stored_tile(uow, tenant, key) is None:
            uow.blobs.refer(tenant, [(TILE_BLOB, sha256)])
            row = MapTileRecord(
                tenant, key.map_id, key.version, key.stored_id, sha256, len(plan.placed), self._context.clock.wall_ns()
            )
            uow.map_tiles.add(row)
            _forget_oldest(uow, tenant, key.map_id)
        return True


def moment_of(payload: dict[str, Any]) -> Moment:
    """The moment that the payload of a job names; jobs of former versions of the service name none."""
    return Moment(payload.get("as_of_ns"), payload.get("ever", False))


def _key(tiling: Tiling, payload: dict[str, Any], cell: Cell) -> TileKey:
    return TileKey(tiling.map_id, tiling.version, payload["frame"], cell, moment_of(payload))


def _forget_oldest(uow: UnitOfWork, tenant: TenantId, map_id: str) -> None:
    """Delete the tiles of a map that are too many."""
    too_many = uow.map_tiles.count(tenant, map_id=map_id) - MOST_STORED
    if too_many > 0:
        for row in uow.map_tiles.find(tenant, limit=too_many, map_id=map_id):
            uow.map_tiles.delete(tenant, number=row.number)
            uow.blobs.release(tenant, {blob_of_tile(row)})
