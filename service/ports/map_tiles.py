"""Tiles of a map: their names, and the method that makes and measures them, as workers call it."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from revisit.core.codec.tile import FusedTile
from revisit.core.errors import BadField
from revisit.core.geometry.tile_grid import Cell
from revisit.core.merge.evidence import DatedChange
from revisit.service.domain.identity import TenantId
from revisit.service.ports.map_merger import PlacedSubmapMap
from revisit.service.ports.transactions import UnitOfWork

_TILE_ID = re.compile(r"(frame-[0-9]{1,19})\.(-?[0-9]{1,9})\.(-?[0-9]{1,9})", re.ASCII)


@dataclass(frozen=True)
class Moment:
    """Which surface of a map is meant: the one that drives up to `as_of_ns` left, all drives where that is None.

    With `ever` nothing is left out that one of them saw.
    """

    as_of_ns: int | None = None
    ever: bool = False

    @property
    def mark(self) -> str:
        """Its part of the name under which a tile is stored."""
        drives = "" if self.as_of_ns is None else f"@{self.as_of_ns}"
        return drives if self.ever else f"{drives}@now"


NOW = Moment()


@dataclass(frozen=True)
class TileKey:
    """A tile of a version of a map at a moment: the frame, and its column and row in the frame's grid."""

    map_id: str
    version: int
    frame: str
    cell: Cell
    moment: Moment = NOW

    @classmethod
    def of(cls, map_id: str, version: int, tile_id: str, moment: Moment = NOW) -> TileKey:
        """The tile that `{frame}.{column}.{row}` names. Raises BadField."""
        found = _TILE_ID.fullmatch(tile_id)
        if found is None:
            raise BadField("a tile is named {frame}.{column}.{row}, such as frame-1.0.-2", field="tile")
        return cls(map_id, version, found[1], (int(found[2]), int(found[3])), moment)

    @property
    def tile_id(self) -> str:
        """Its id within the version."""
        return f"{self.frame}.{self.cell[0]}.{self.cell[1]}"

    @property
    def stored_id(self) -> str:
        """Under which it is stored within the version."""
        return self.tile_id + self.moment.mark

    @property
    def name(self) -> str:
        """Its resource name."""
        return f"maps/{self.map_id}/versions/{self.version}/tiles/{self.tile_id}"


class TileMaker(Protocol):
    """Fuses the neural maps of submaps to the surface of a tile, and measures in it."""

    def fuse(
        self, placed: Sequence[PlacedSubmapMap], centre_m: NDArray[np.float64], read: Callable[[str], bytes]
    ) -> FusedTile | None:
        """The tile of the square centred at `centre_m` (3,); `read` gets a neural map by its hash.

        What a later drive looked through is left out, of maps that say their drive (`PlacedSubmapMap`).
        None where nothing was seen there. Raises DataLoss, DescriptorModelMismatch, BadField.
        """
        ...

    def changes(
        self, placed: Sequence[PlacedSubmapMap], centre_m: NDArray[np.float64], read: Callable[[str], bytes]
    ) -> list[DatedChange]:
        """What drives found changed in the same square, in the order of time. Raises as `fuse`."""
        ...

    def distances_m(
        self, neural_map: bytes, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Signed distances (n,) of points (n, 3) of the frame to the surface; those (n,) to the nearest neural point.

        The latter are inf where nothing is known.
        """
        ...


def stored_tile(uow: UnitOfWork, tenant: TenantId, key: TileKey) -> str | None:
    """The hash of the blob of a tile, None where it was not made yet."""
    row = uow.map_tiles.get(tenant, key.map_id, key.version, key.stored_id)
    return None if row is None else row.tile_sha256
