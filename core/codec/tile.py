"""Tiles as they are stored: neural map, mesh and points of one tile in one checked blob."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.codec.container import Container
from revisit.core.codec.mesh import Mesh, pack_mesh, unpack_mesh
from revisit.core.errors import DataLoss

# What it holds is compressed already.
_CONTAINER = Container(b"RVMT\x01", "stored tile", level=1, max_body_bytes=2**29)

_NOTHING = np.zeros((0, 3), np.float32)
EMPTY = Mesh(_NOTHING, _NOTHING, np.zeros((0, 3), np.int32))
"""A mesh of nothing."""


@dataclass(frozen=True)
class FusedTile:
    """The surface of a tile: its neural map, a mesh, and points (a mesh without faces), metres from its middle."""

    neural_map: bytes
    mesh: Mesh
    points: Mesh


class StoredTile:
    """A tile out of its blob; `centre_m` (3,) is what its mesh and points are measured from."""

    def __init__(self, blob: bytes) -> None:
        """Raises DataLoss for damage."""
        header, body = _CONTAINER.unpack(blob)
        try:
            ends = [0, *itertools.accumulate(int(length) for length in header["sections"])]
            self._parts = [body[start:end] for start, end in itertools.pairwise(ends)]
            self.centre_m: NDArray[np.float64] = np.array(header["centre_m"], dtype=np.float64).reshape(3)
            self.neural_map, self._mesh, self._points = self._parts
        except (KeyError, TypeError, ValueError) as error:
            raise DataLoss("the stored tile cannot be read") from error

    @property
    def mesh(self) -> Mesh:
        """Its surface. Raises DataLoss."""
        return unpack_mesh(self._mesh)

    @property
    def points(self) -> Mesh:
        """Its points with normals, a mesh without faces. Raises DataLoss."""
        return unpack_mesh(self._points)


def pack_tile(tile: FusedTile | None, centre_m: NDArray[np.float64]) -> bytes:
    """The blob of a tile; None for one in which nothing was seen."""
    made = FusedTile(b"", EMPTY, EMPTY) if tile is None else tile
    parts = [made.neural_map, pack_mesh(made.mesh), pack_mesh(made.points)]
    header = {"centre_m": centre_m.tolist(), "sections": [len(part) for part in parts]}
    return _CONTAINER.pack(header, b"".join(parts))
