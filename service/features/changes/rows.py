"""What changed between the drives of a version, as it is stored: one blob, which grows square by square."""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass, replace
from typing import Any

from revisit.core.errors import DataLoss
from revisit.core.geometry.tile_grid import Cell
from revisit.core.merge.evidence import CHANGE_REACH_M, DatedChange
from revisit.service.domain.identity import TenantId
from revisit.service.features.graph.told_changes import DriveChanges
from revisit.service.features.tiles.rows import Tiling
from revisit.service.ports.map_tiles import TileKey
from revisit.service.ports.transactions import UnitOfWork

STORED_ID = "changes"
"""Its row stands among the tiles of its version, and goes with them."""


@dataclass(frozen=True)
class MapChange:
    """A change in a frame of a version: a box along the axes of the frame, metres, and which drive found it when.

    `before_ns` is when the place was last seen as it was before; `moved_from_m` where a thing that moved had stood.
    """

    frame: str
    kind: str
    centre_m: tuple[float, float, float]
    extent_m: tuple[float, float, float]
    points: int
    session: int
    stamp_ns: int
    before_ns: int
    moved_from_m: tuple[float, float, float] | None = None

    @classmethod
    def of(cls, frame: str, found: DatedChange) -> MapChange:
        """A change that was found in a frame, rounded to millimetres."""
        thing, start = found.thing, found.moved_from_m
        boxes = (_rounded(thing.centre_m), _rounded(thing.extent_m))
        dates = (found.session, found.stamp_ns, found.before_ns)
        return cls(frame, thing.kind.value, *boxes, thing.points, *dates, None if start is None else _rounded(start))

    @property
    def order(self) -> tuple[Any, ...]:
        """In the order of time, the largest first."""
        return self.stamp_ns, -self.points, self.frame, self.centre_m, self.kind


@dataclass(frozen=True)
class FoundChanges:
    """The changes that were found so far, and how many of the squares of the version were compared, in their order."""

    compared: int
    squares: int
    changes: tuple[MapChange, ...]

    @property
    def complete(self) -> bool:
        """Whether every square was compared."""
        return self.compared >= self.squares

    def to_blob(self) -> bytes:
        """As it is stored."""
        fields = {**vars(self), "changes": [vars(one) for one in self.changes]}
        return zlib.compress(json.dumps(fields, sort_keys=True).encode())

    @classmethod
    def of(cls, blob: bytes) -> FoundChanges:
        """The inverse of `to_blob`. Raises DataLoss."""
        try:
            fields = json.loads(zlib.decompress(blob))
            changes = tuple(MapChange(**{**one, **_boxes(one)}) for one in fields["changes"])
            return cls(fields["compared"], fields["squares"], changes)
        except (KeyError, TypeError, ValueError, zlib.error) as error:
            raise DataLoss("the stored changes of a map cannot be read") from error

    def of_drive(self, version: int, session: int) -> DriveChanges:
        """What the drive of a session, by number, found changed."""
        return DriveChanges.of_kinds(version, [one.kind for one in self.changes if one.session == session])

    def with_square(self, found: list[MapChange]) -> FoundChanges:
        """After one more square."""
        return replace(self, compared=self.compared + 1, changes=self.changes + tuple(found))


def compared_squares(tiling: Tiling, scale: float) -> list[TileKey]:
    """The squares of a version that two of its sessions have seen, in their order."""
    return [
        TileKey(tiling.map_id, tiling.version, one.frame, cell)
        for one in tiling.frames
        for cell, rows in _near(tiling, one.positions, scale).items()
        if len(set(one.sessions[rows].tolist())) > 1
    ]


def stored_changes(uow: UnitOfWork, tenant: TenantId, map_id: str, version: int) -> str | None:
    """The hash of the blob with the changes of a version; None where nobody looked for them yet."""
    row = uow.map_tiles.get(tenant, map_id, version, STORED_ID)
    return None if row is None else row.tile_sha256


def _near(tiling: Tiling, positions: Any, scale: float) -> dict[Cell, Any]:
    return tiling.grid.reached(positions, CHANGE_REACH_M * scale)


def _boxes(fields: dict[str, Any]) -> dict[str, Any]:
    start = fields["moved_from_m"]
    boxes = {name: tuple(fields[name]) for name in ("centre_m", "extent_m")}
    return {**boxes, "moved_from_m": None if start is None else tuple(start)}


def _rounded(place: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = (round(value, 3) for value in place)
    return x, y, z
