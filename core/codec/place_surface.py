"""The surface of a place as stored: a point a voxel, coarse along its plane, fine across (decision 0287)."""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from revisit.core.codec.learned_chances import learned_chances
from revisit.core.errors import DataLoss
from revisit.core.geometry import octahedral
from revisit.core.geometry.voxel_keys import first_rows, voxel_keys
from revisit.core.kernels.facet_coder import ACROSS, FACET_MODELS, NORMAL_CODES, code_facets, spread_out
from revisit.core.kernels.octree_coder import RANKS, THINNED_MODELS, Thinning, code_octree, ranks_of
from revisit.core.kernels.range_coder import Coder, Models, finish, position, start
from revisit.core.kernels.voxel_families import families_of
from revisit.core.kernels.voxel_table import rows_of, table_of

Array = NDArray[np.float32]
Whole = NDArray[np.int64]
Kind = Literal["standing", "ground"]

NORMAL_STEPS = NORMAL_CODES // 2
CORNER = 0.5 / ACROSS
"""By how much of an edge voxels begin before the origin.

The vertices of a surface lie on planes through the origin, two or four to a voxel: so they are in the middle of cells.
"""
MAX_DEPTH = 16
LEARNED = "place-1.npz"
"""Where in core/weights the chances are with which the models of a surface begin."""
MODELS = THINNED_MODELS + FACET_MODELS

_FARTHEST_VOXEL = 1 << (MAX_DEPTH - 1)
_LEAST_COMPONENT = 0.3
_HEAD = struct.Struct("<3hBHI")  # lowest voxel, depth, least rank of seldom voxels in parts of _RANK, points
_RANK = 256
_BYTES_EACH = 4
_FIXED = 1024


def kinds(spacing: float) -> dict[Kind, tuple[float, int]]:
    """By kind of surface the edge of its voxels, and steps along one: a power of two up to 64."""
    return {"standing": (spacing, 32), "ground": (2.0 * spacing, 64)}


def write_surface(points: Array, normals: Array, spacing: float, kind: Kind) -> bytes:
    """Points (n, 3) and unit normals (n, 3) of one kind, of each voxel the first; their order is not kept.

    Voxels as an octree, normals, and places in the voxels, all coded by context: one of so many steps along the axis
    that the normal is nearest to, one of ACROSS cells along either other. What is read again is written as the same
    bytes.
    """
    edge, steps = kinds(spacing)[kind]
    if not len(points):
        return b""
    return coded(*rounded(points, normals, edge, steps), steps, begun(kind))


def coded(voxels: Whole, places: Whole, codes: Whole, steps: int, models: Models) -> bytes:
    """The stream of voxels, places within them and codes of normals, as of `rounded`; the models learn of it."""
    low = voxels.min(axis=0)
    inside = (voxels - low).astype(np.int32)
    depth = max(int(inside.max()).bit_length(), 1)
    thinning = Thinning((int(low[0]), int(low[1]), int(low[2])), _seldom_from(ranks_of(voxels)))
    room, fresh = 1024 + _BYTES_EACH * len(voxels), models.copy()
    while True:
        data, models[:] = np.zeros(room, dtype=np.uint8), fresh
        coder = start(data, False)
        ordered = code_octree(coder, data, models[:THINNED_MODELS], inside, depth, len(inside), thinning)
        rows = rows_of(table_of(inside), ordered)
        found = _steepest_first(places[rows], codes[rows])
        _code(coder, data, models, ordered, codes[rows].astype(np.int32), found, steps)
        room = finish(coder, data)
        if room <= len(data):
            return _HEAD.pack(*thinning.low, depth, thinning.below // _RANK, len(inside)) + data[:room].tobytes()


def read_surface(stream: bytes, spacing: float, limit: int, kind: Kind) -> tuple[Array, Array]:
    """Points (n, 3) and normals (n, 3) of a stream. Raises DataLoss for what `write_surface` did not write."""
    if not stream:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)
    if len(stream) < _HEAD.size:
        raise DataLoss("the surface of the place is cut short")
    x, y, z, depth, seldom, count = _HEAD.unpack_from(stream)
    if not (1 <= depth <= MAX_DEPTH and 0 < count <= limit and seldom <= RANKS // _RANK):
        raise DataLoss("the surface of the place is unusable")
    data = np.frombuffer(stream, np.uint8, offset=_HEAD.size).copy()  # the compiled coder could also write
    coder, models, thinning = start(data, True), begun(kind), Thinning((x, y, z), seldom * _RANK)
    voxels = code_octree(
        coder, data, models[:THINNED_MODELS], np.zeros((0, 3), np.int32), depth, count, thinning
    )  # fmt: skip
    if len(voxels) != count:
        raise DataLoss("the surface of the place does not hold what it says")
    codes, places = np.zeros((count, 2), np.int32), np.zeros((count, 3), np.int32)
    edge, steps = kinds(spacing)[kind]
    _code(coder, data, models, voxels, codes, places, steps)
    if position(coder) != len(data):
        raise DataLoss("the surface of the place does not hold what it says")
    return _geometry(voxels, np.array([x, y, z]), codes, places, edge, steps)


def settled_surface(points: Array, normals: Array, spacing: float, kind: Kind) -> tuple[Array, Array]:
    """What `read_surface` reads of what `write_surface` writes of them, without writing it."""
    edge, steps = kinds(spacing)[kind]
    if not len(points):
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)
    voxels, places, codes = rounded(points, normals, edge, steps)
    order = np.argsort(_tree_keys(voxels - voxels.min(axis=0)))
    found = _steepest_first(places[order], codes[order])
    return _geometry(
        voxels[order].astype(np.int32), np.zeros(3, np.int64), codes[order].astype(np.int32), found, edge, steps
    )


def _steepest_first(places: Whole, codes: Whole) -> NDArray[np.int32]:
    """Places in voxels (n, 3) as they are coded: along the axis nearest to the normal first, then along the others."""
    steepest = along(codes)
    return np.column_stack([places[steepest], places[~steepest].reshape(-1, 2)]).astype(np.int32)


def _tree_keys(voxels: Whole) -> Whole:
    """Numbers (n,) in the order in which an octree lists `voxels` (n, 3): bits of x, y and z by turns."""
    spread = voxels.astype(np.int64)
    for shift, mask in ((16, 0x0000FF0000FF), (8, 0x00F00F00F00F), (4, 0x0C30C30C30C3), (2, 0x249249249249)):
        spread = (spread | spread << shift) & mask
    return np.asarray(spread @ np.array([4, 2, 1]))


def _geometry(
    voxels: NDArray[np.int32], low: Whole, codes: NDArray[np.int32], places: NDArray[np.int32], edge: float, steps: int
) -> tuple[Array, Array]:
    """Points (n, 3) and normals (n, 3) of what is coded, voxels counted from `low` on."""
    points = np.empty((2, len(voxels), 3), dtype=np.float32)
    listed = octahedral.listed(NORMAL_STEPS), octahedral.steepest_axes(NORMAL_STEPS)
    spread_out(voxels, codes, places, *listed, low, steps, CORNER, edge, points)
    return points[0], points[1]


def begun(kind: Kind) -> Models:
    """The models (MODELS, 2) with which the stream of a surface begins."""
    return _learned()[kind].copy()


def _code(
    coder: Coder, data: NDArray[np.uint8], models: Models, voxels: NDArray[np.int32], codes: NDArray[np.int32],
    places: NDArray[np.int32], steps: int,
) -> None:  # fmt: skip
    """Write `codes` (n, 2) and `places` (n, 3), or read and fill them."""
    code_facets(
        coder, data, models[THINNED_MODELS:], families_of(voxels), codes, places, _vectors(),
        octahedral.steepest_axes(NORMAL_STEPS), steps.bit_length() - 1,
    )  # fmt: skip


def _seldom_from(ranks: Whole) -> int:
    """From which rank on voxels are seldom, a multiple of _RANK: the split of the ranks (n,) that tells most."""
    count, parts = len(ranks), RANKS // _RANK
    below = np.cumsum(np.bincount(ranks // _RANK, minlength=parts))[:-1]
    share = np.arange(1, parts) / parts
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = below * np.log(below / count / share)
        gain += np.nan_to_num((count - below) * np.log((count - below) / count / (1.0 - share)))
    best = int(np.argmax(np.nan_to_num(gain)))
    return (best + 1) * _RANK if gain[best] > 0.05 * count else RANKS


def rounded(points: Array, normals: Array, edge: float, steps: int) -> tuple[Whole, Whole, Whole]:
    """Voxels (n, 3), places within them (n, 3) and codes of normals (n, 2): one point a voxel.

    A point moves within its plane to the middle of its cell, so that it stays on the surface, but never into the voxel
    of another point.
    """
    codes = octahedral.encode(normals, NORMAL_STEPS)
    # a normal straight down or on a fold has several codes: the one that is found again
    codes = octahedral.encode(octahedral.decode(codes, NORMAL_STEPS), NORMAL_STEPS)
    fine = along(codes)
    exact, facing = points.astype(np.float64) / edge + CORNER, normals.astype(np.float64)
    exact = np.clip(exact, 1 - _FARTHEST_VOXEL // 2, _FARTHEST_VOXEL // 2 - 1)
    cells = np.floor(exact * ACROSS)
    aside = np.where(fine, 0.0, (cells + 0.5) / ACROSS - exact)
    slope = (facing * fine).sum(axis=1)
    slope = np.where(slope < 0.0, -1.0, 1.0) * np.maximum(np.abs(slope), _LEAST_COMPONENT)
    levels = np.floor((exact - fine * ((facing * aside).sum(axis=1) / slope)[:, None]) * steps)
    home = np.floor(exact)
    keys, count = voxel_keys(np.concatenate([home, np.where(fine, np.floor(levels / steps), home)])), len(home)
    taken = np.isin(keys[count:], keys[:count])  # by itself or another point
    levels = np.where(taken[:, None], np.clip(levels, steps * home, steps * home + steps - 1), levels)
    rows = np.sort(first_rows(np.where(taken, keys[:count], keys[count:])))
    voxels, places = np.divmod(np.where(fine, levels, cells)[rows], np.where(fine, steps, ACROSS)[rows])
    return voxels.astype(np.int64), places.astype(np.int64), codes[rows].astype(np.int64)


def along(codes: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Which axis (n, 3) each normal is nearest to, one for each; of two alike the first."""
    return np.asarray(octahedral.steepest_axes(NORMAL_STEPS)[codes[:, 0], codes[:, 1]][:, None] == np.arange(3))


@lru_cache(maxsize=1)
def _vectors() -> NDArray[np.int32]:
    """The normal (n, n, 3) of each octahedral code in parts of _FIXED."""
    side = np.arange(NORMAL_CODES)
    codes = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1).reshape(-1, 2)
    vectors = np.rint(octahedral.decode(codes, NORMAL_STEPS) * _FIXED)
    return vectors.astype(np.int32).reshape(NORMAL_CODES, NORMAL_CODES, 3)


@lru_cache(maxsize=1)
def _learned() -> dict[str, Models]:
    """The learned models by kind of surface."""
    return {kind: learned_chances(LEARNED, f"{kind}_") for kind in ("standing", "ground")}
