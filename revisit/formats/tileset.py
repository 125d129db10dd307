"""Tilesets of OGC 3D Tiles 1.1: a JSON file that tells viewers which GLB files a map consists of, and their boxes."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.formats.glb import Bounds

NAME = "tileset.json"

ERROR_SHARE = 0.25
"""The geometric error of a map that is not drawn, as a share of its diagonal: viewers load tiles once it would show."""


@dataclass(frozen=True)
class TileFile:
    """A file beside the tileset, and the box of its content in the map, z up, metres."""

    uri: str
    bounds: Bounds


def tileset(tiles: Sequence[TileFile], T_ecef_map: NDArray[np.float64] | None = None) -> str:
    """The JSON of the tiles, at least one, in the frame of the map, which T_ecef_map (4, 4) puts on earth.

    Viewers turn the y up of glTF to the z up of 3D Tiles themselves, so there is no transform for that.
    """
    low = np.min([tile.bounds.low for tile in tiles], axis=0)
    high = np.max([tile.bounds.high for tile in tiles], axis=0)
    whole = Bounds(tuple(low.tolist()), tuple(high.tolist()))
    error = ERROR_SHARE * float(np.linalg.norm(high - low))
    children = [{**_tile(tile.bounds, 0.0), "content": {"uri": tile.uri}} for tile in tiles]
    placed = {} if T_ecef_map is None else {"transform": T_ecef_map.T.ravel().tolist()}  # column by column
    root = {**placed, **_tile(whole, error), "refine": "ADD", "children": children}
    return json.dumps({"asset": {"version": "1.1"}, "geometricError": error, "root": root}, indent=1) + "\n"


def _tile(bounds: Bounds, error: float) -> dict[str, Any]:
    """A box: its middle, and half of each edge as a vector."""
    low, high = np.asarray(bounds.low), np.asarray(bounds.high)
    half = np.diag((high - low) / 2)
    return {"boundingVolume": {"box": [*((low + high) / 2).tolist(), *half.ravel().tolist()]}, "geometricError": error}
