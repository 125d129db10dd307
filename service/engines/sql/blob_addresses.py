"""The addresses of all blobs that rows refer to, as one statement."""

from __future__ import annotations

from typing import Any

from sqlalchemy import Column, CompoundSelect, Select, literal, select, text, union

from revisit.service.engines.sql.tables import map_files, map_tiles, plans, scans, submaps
from revisit.service.ports.blobs import (
    CLOUD_BLOB,
    MAP_LAYOUT_BLOB,
    MERGE_PORTION_BLOB,
    MESH_BLOB,
    NEURAL_MAP_BLOB,
    PLACE_BLOB,
    PLAN_BLOB,
    QUERY_CLOUD_BLOB,
    TILE_BLOB,
)

REFERENCES: tuple[tuple[str, Column[Any]], ...] = (
    (CLOUD_BLOB, scans.c.cloud_sha256),
    (CLOUD_BLOB, submaps.c.cloud_sha256),
    (PLACE_BLOB, submaps.c.place_sha256),
    (NEURAL_MAP_BLOB, submaps.c.neural_map_sha256),
    (TILE_BLOB, map_tiles.c.tile_sha256),
    (MAP_LAYOUT_BLOB, map_files.c.layout_sha256),
    (PLAN_BLOB, plans.c.image_sha256),
)
"""(kind of blob, column with its hash)."""

NAMED_BY_NO_ROW = (QUERY_CLOUD_BLOB, MESH_BLOB, MERGE_PORTION_BLOB)
"""Kinds of blobs on their way between two processes, or two runs of a job: the last one deletes them."""


def blob_addresses() -> CompoundSelect[Any]:
    """(tenant, kind, sha256) of every blob that a row refers to, each once, in the order of these three."""
    return union(*(_of_column(kind, column) for kind, column in REFERENCES)).order_by(text("1, 2, 3"))


def _of_column(kind: str, column: Column[Any]) -> Select[Any]:
    return select(column.table.c.tenant, literal(kind), column).where(column.is_not(None), column != "")
