"""Clouds as COPC: LAZ 1.4 in an octree, of which a viewer loads the part and the detail that it shows; written only.

Each node holds one point in each cell of a grid of its cube, 128 to a side; its children hold the others, in cells of
half the size. A node whose points are few keeps them all. In a node, points that follow each other lie beside each
other: LASzip stores differences. Needs the package `copclib` (extra `crs`).
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from pathlib import Path

import copclib
import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.core.geometry.voxel_keys import first_rows, grouped, voxel_keys
from revisit.core.point_columns import NONE, RGB, RING, TIME, Columns
from revisit.formats.las import EXTRA_BYTES, SCALE_M, Millimetres, extra_dimension, fill
from revisit.formats.whole_files import written_beside

CELLS = 128
"""Along the side of a node's cube."""

FEW_POINTS = 4096
"""So many points are not divided further."""

_PLAIN_FORMAT, _COLOURED_FORMAT = 6, 7
_ROW = [
    ("xyz", "<i4", (3,)), ("intensity", "<u2", ()), ("returns", "u1", ()), ("rest", "u1", (5,)), ("source", "<u2", ()),
    ("time", "<f8", ()),
]  # fmt: skip
_FURTHER = [("rgb", "<u2", (3,)), ("ring", "u1", ())]
MAX_RING = 255
"""The writer has room for one byte in a dimension of its own."""

_FIRST_OF_ONE = 0x11
_HEAD_BYTES, _RECORD_HEAD_BYTES = 65_536, 54
_SLAB = 100
"""Steps: the thickness of the slabs along x in whose order a node has its points."""

Node = tuple[int, int, int, int]
"""Depth, then the place of the cube along x, y and z among those of its depth."""


def write(path: Path, points: NDArray[np.floating], wkt: str = "", columns: Columns = NONE) -> None:
    """Write points (n, 3) in metres with their columns, as `laz.encode` has them; `wkt` describes their reference
    system.

    It has its name once it is whole. Raises BadField as `Millimetres.of` and for a ring above `MAX_RING`, and OSError
    where it cannot be written.
    """
    stored, ringed = Millimetres.of(points), RING.name in columns
    if ringed and columns[RING.name].max() > MAX_RING:
        raise BadField(f"a file of COPC holds rings up to {MAX_RING} here; LAZ holds more", field=RING.name)
    low, high = stored.bounds()
    scale, further = copclib.Vector3(*[SCALE_M] * 3), copclib.EbVlr(int(ringed))
    point_format = _COLOURED_FORMAT if RGB.name in columns else _PLAIN_FORMAT
    config = copclib.CopcConfigWriter(point_format, scale, copclib.Vector3(*stored.offset), wkt, further)
    config.las_header.min, config.las_header.max = copclib.Vector3(*low), copclib.Vector3(*high)
    if TIME.name in columns:
        config.las_header.SetGpsTimeBit()
    half_m = CELLS * _cell(stored.counts) * SCALE_M / 2
    info = config.copc_info
    info.center_x, info.center_y, info.center_z = (float(least) + half_m for least in low)
    info.halfsize, info.spacing = half_m, 2 * half_m / CELLS
    with written_beside(path) as part:
        _write_nodes(part, config, stored, _rows(stored, columns))
        if ringed:
            _name_ring(part)


def _name_ring(path: Path) -> None:
    """Describe the dimension of its own, to which the writer gives no name."""
    with path.open("r+b") as file:
        file.seek(file.read(_HEAD_BYTES).index(EXTRA_BYTES[0].encode() + b"\0") - 2 + _RECORD_HEAD_BYTES)
        file.write(extra_dimension("<u1"))


def _write_nodes(path: Path, config: copclib.CopcConfigWriter, stored: Millimetres, rows: NDArray[np.void]) -> None:
    """Write the file. Raises OSError where it cannot be opened, or there is no room."""
    writer = None
    try:
        writer = copclib.FileWriter(str(path), config)
        for node, chosen in octree(stored.counts):
            writer.AddNode(copclib.VoxelKey(*node), copclib.VectorChar(rows[chosen].view(np.int8)))
        writer.Close()
    except RuntimeError as error:
        # The end of a writer whose file takes no more would end the process.
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(writer))
        raise OSError(f"{path} cannot be written: {error}") from error


def octree(counts: NDArray[np.int32]) -> Iterator[tuple[Node, NDArray[np.intp]]]:
    """The nodes of points (n, 3) in whole steps, each with the rows of its points; a parent comes before its children.

    The cube of the root begins at the least coordinates and is a step wider than the widest side.
    """
    from_corner = counts.astype(np.int64) - counts.min(axis=0)
    cell = _cell(counts)
    left, depth = np.random.default_rng(0).permutation(len(counts)), 0
    while len(left):
        cells = (from_corner[left] / cell).astype(np.int64)
        cube, population = grouped(voxel_keys(cells // CELLS))
        taken = (population[cube] <= FEW_POINTS) | (cell <= 1)
        taken[first_rows(voxel_keys(cells))] = True
        for number in range(len(population)):
            rows = np.flatnonzero(taken & (cube == number))
            x, y, z = (cells[rows[0]] // CELLS).tolist()
            yield (depth, x, y, z), _along(counts, left[rows])
        left, depth, cell = left[~taken], depth + 1, cell / 2


def _along(counts: NDArray[np.int32], rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """Those rows in the order of slabs along x, in a slab of y, then of z."""
    x, y, z = counts[rows].T
    return rows[np.lexsort((z, y, x // _SLAB))]


def _cell(counts: NDArray[np.int32]) -> float:
    """The side of a cell of the root, in steps."""
    return max(1.0, (float(np.ptp(counts.astype(np.int64), axis=0).max()) + 1.0) / CELLS)


def _rows(stored: Millimetres, columns: Columns) -> NDArray[np.void]:
    """The points as point records of format 6, of 7 with colours; the ring behind it."""
    rows = np.zeros(len(stored.counts), dtype=[*_ROW, *(one for one in _FURTHER if one[0] in columns)])
    rows["xyz"], rows["returns"] = stored.counts, _FIRST_OF_ONE
    fill(rows, columns)
    return rows
