"""Vertices and triangles in the bitstreams of the glTF extension EXT_meshopt_compression.

Written after the extension's specification: no Python package of it is kept up, see decision 0167. Attributes are
stored as differences of bytes in groups of 16, triangles by the edges and vertices that they share with the last ones.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

_ATTRIBUTES_HEAD, _TRIANGLES_HEAD = 0xA0, 0xE1
_GROUP = 16
_TAIL_BYTES = 32
_TABLE = 16
"""Common pairs of codes that a list of triangles names once."""
_NAMED = 14
_NAMED_BY_NUMBER = 15
_NEW, _LAST, _SIZE = range(3)
"""Places of what is kept between triangles: the next new vertex, the last one named by its number, bytes written."""
_INNER: dict[str, Any] = {"nogil": True, "cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""How functions are compiled that only compiled ones call."""

Bytes = NDArray[np.uint8]
Whole = NDArray[np.int64]


def encode_attributes(rows: Bytes) -> bytes:
    """Rows (n, s) of attributes, as bytes; s is a multiple of 4, at most 256."""
    count, stride = rows.shape
    out = np.zeros(2 * count * stride + 64 * stride + 2 * _TAIL_BYTES, dtype=np.uint8)
    size = _attributes(np.ascontiguousarray(rows), out)
    tail = bytes(max(0, _TAIL_BYTES - stride)) + (rows[0].tobytes() if count else bytes(stride))
    return bytes([_ATTRIBUTES_HEAD]) + out[:size].tobytes() + tail


def encode_triangles(faces: NDArray[np.integer]) -> bytes:
    """Triangles (f, 3), best with vertices numbered in the order in which they are first named."""
    triangles = np.ascontiguousarray(faces, dtype=np.int64)
    codes, data = np.zeros(len(triangles), np.uint8), np.zeros(16 * len(triangles), np.uint8)
    used = np.zeros(256, np.int64)
    table = np.zeros(_TABLE, np.uint8)
    _triangles(triangles, table[:0], codes, data, used)
    table[:_NAMED] = np.argsort(-used, kind="stable")[:_NAMED]
    table[used[table] == 0] = 0
    size = _triangles(triangles, table[:_NAMED], codes, data, np.zeros(256, np.int64))
    return bytes([_TRIANGLES_HEAD]) + codes.tobytes() + data[:size].tobytes() + table.tobytes()


def along_edges(faces: NDArray[np.integer]) -> Whole:
    """Triangles (f, 3) in an order in which most share an edge with one of the last."""
    triangles = np.ascontiguousarray(faces, dtype=np.int64)
    return triangles[_walk(_neighbours(triangles))]


def _neighbours(faces: Whole) -> Whole:
    """For each of the edges of triangles (f, 3), the other triangle at it, -1 for none."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    keys = ends[:, 0] * (faces.max(initial=0) + 1) + ends[:, 1]
    order = np.argsort(keys, kind="stable")
    pairs = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    found = np.full(len(keys), -1, np.int64)
    found[order[pairs]] = order[pairs + 1] // 3
    found[order[pairs + 1]] = order[pairs] // 3
    return found.reshape(-1, 3)


@njit(nogil=True, cache=True, error_model="numpy")
def _walk(neighbours: Whole) -> Whole:
    """Every triangle once: on from the last one over its edges as far as it goes, then back."""
    count = len(neighbours)
    order, done = np.zeros(count, np.int64), np.zeros(count, np.bool_)
    stack = np.zeros(3 * count + 1, np.int64)
    size = 0
    for start in range(count):
        stack[0], top = start, 1
        while top > 0:
            top -= 1
            here = stack[top]
            if done[here]:
                continue
            done[here] = True
            order[size] = here
            size += 1
            for edge in range(3):
                other = neighbours[here, edge]
                if other >= 0 and not done[other]:
                    stack[top] = other
                    top += 1
    return order


def in_order_of_use(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> tuple[NDArray[np.floating], Whole]:
    """The vertices that faces name, in the order in which they first do, and the faces with their new numbers."""
    used, first, named = np.unique(faces, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return vertices[used[order]], rank[named.reshape(faces.shape)]


@njit(nogil=True, cache=True, error_model="numpy")
def _attributes(rows: Bytes, out: Bytes) -> int:
    """Bytes written to `out`: blocks of rows, in them one byte of all rows after the other."""
    count, stride = rows.shape
    block, written = min((8192 // stride) & ~15, 256), 0
    deltas = np.zeros(_GROUP, np.uint8)
    for start in range(0, count, block):
        end = min(start + block, count)
        groups = (end - start + _GROUP - 1) // _GROUP
        for column in range(stride):
            head = written
            written += (groups + 3) // 4
            for group in range(groups):
                _fill_deltas(rows, start + group * _GROUP, end, column, deltas)
                mode = _cheapest(deltas)
                out[head + group // 4] |= mode << (2 * (group % 4))
                written = _group(deltas, mode, out, written)
    return written


@register_jitable(**_INNER)
def _fill_deltas(rows: Bytes, first: int, end: int, column: int, deltas: Bytes) -> None:
    """One byte of each of 16 rows, before `end`, as its difference from the row before."""
    for k in range(_GROUP):
        row, coded = first + k, np.int64(0)
        if row < end:
            change = (np.int64(rows[row, column]) - np.int64(rows[max(row - 1, 0), column])) & 255
            coded = (change << 1) & 255 if change < 128 else 511 - 2 * change
        deltas[k] = coded


@register_jitable(**_INNER)
def _cheapest(deltas: Bytes) -> int:
    """The mode of a group, 0 to 3, for differences of 0, 2, 4 or 8 bits: larger ones are stored behind the group."""
    some, above_two, above_four = 0, 0, 0
    for k in range(_GROUP):
        some += deltas[k] > 0
        above_two += deltas[k] >= 3
        above_four += deltas[k] >= 15
    if some == 0:
        return 0
    with_two, with_four = 4 + above_two, 8 + above_four
    if with_two <= with_four and with_two < _GROUP:
        return 1
    return 2 if with_four < _GROUP else 3


@register_jitable(**_INNER)
def _group(deltas: Bytes, mode: int, out: Bytes, written: int) -> int:
    """16 differences in a mode; where the next group goes."""
    if mode == 0:
        return written
    bits = 1 << mode
    large, each = (1 << bits) - 1, 8 // bits
    behind = written + _GROUP // each
    for number in range(_GROUP):
        delta = np.int64(deltas[number])
        kept = delta if delta < large else large
        out[written + number // each] |= kept << (bits * (each - 1 - number % each))
        if mode < 3 and delta >= large:
            out[behind] = delta
            behind += 1
    return behind


@njit(nogil=True, cache=True, error_model="numpy")
def _triangles(faces: Whole, table: Bytes, codes: Bytes, data: Bytes, used: Whole) -> int:
    """Bytes of `data`; `used` counts the pairs of codes that entries of the table could name."""
    edges, corners, state = np.empty((16, 2), np.int64), np.empty(16, np.int64), np.zeros(3, np.int64)
    edges[:], corners[:] = -1, -1
    for number in range(len(faces)):
        face = faces[number]
        place = _shared_edge(edges, face)
        turn = place % 3 if place >= 0 else _first_corner(face, state[_NEW])
        a, b, c = face[turn], face[(turn + 1) % 3], face[(turn + 2) % 3]
        if place >= 0:
            codes[number] = (place // 3 << 4) | _third_corner(c, corners, state, data)
        else:
            codes[number] = _free(a, b, c, corners, state, table, data, used)
            _remember_edge(edges, b, a)
        _remember_edge(edges, c, b)
        _remember_edge(edges, a, c)
    return int(state[_SIZE])


@register_jitable(**_INNER)
def _shared_edge(edges: Whole, face: Whole) -> int:
    """Three times the place of the latest of the last 15 edges that a triangle shares, and the corner at which it
    begins; -1 for none.
    """
    for place in range(45):
        edge, turn = place // 3, place % 3
        if edges[edge, 0] == face[turn] and edges[edge, 1] == face[(turn + 1) % 3]:
            return place
    return -1


@register_jitable(**_INNER)
def _first_corner(face: Whole, new: int) -> int:
    """The corner that is the next new vertex, else the first one."""
    for turn in range(3):
        if face[turn] == new:
            return turn
    return 0


@register_jitable(**_INNER)
def _third_corner(c: int, corners: Whole, state: Whole, data: Bytes) -> int:
    """The code of the corner opposite to a shared edge: new, one of the last, beside the last named, or named."""
    code = 0
    if c == state[_NEW]:
        state[_NEW] += 1
    else:
        for place in range(1, 13):
            if corners[place] == c:
                return place
        code = 13 if c == state[_LAST] - 1 else 14 if c == state[_LAST] + 1 else 15
        if code == 15:
            _name(c, state, data)
        state[_LAST] = c
    _remember(corners, c)
    return code


@register_jitable(**_INNER)
def _free(a: int, b: int, c: int, corners: Whole, state: Whole, table: Bytes, data: Bytes, used: Whole) -> int:
    """The code of a triangle without a shared edge: its corners are new, among the last 14, or named by number."""
    first = _NAMED_BY_NUMBER
    if a == state[_NEW]:
        state[_NEW] += 1
        first = 0
    second = _corner(b, corners, state)
    # Both 0 behind a first one that is not new would tell the reader to begin anew.
    third = _NAMED_BY_NUMBER if first != 0 and second == 0 else _corner(c, corners, state)
    pair = (second << 4) | third
    code = 255 if first != 0 else 254
    if first == 0 and second != _NAMED_BY_NUMBER and third != _NAMED_BY_NUMBER:
        used[pair] += 1
        for place in range(len(table)):
            if table[place] == pair:
                code = 240 + place
                break
    if code >= 254:
        data[state[_SIZE]] = pair
        state[_SIZE] += 1
    for corner, how in ((a, first), (b, second), (c, third)):
        if how == _NAMED_BY_NUMBER:
            _name(corner, state, data)
            state[_LAST] = corner
        if how == 0 or how == _NAMED_BY_NUMBER:
            _remember(corners, corner)
    return code


@register_jitable(**_INNER)
def _corner(vertex: int, corners: Whole, state: Whole) -> int:
    """0 for the next new vertex, 1 to 14 for one of the last, 15 for one that must be named."""
    if vertex == state[_NEW]:
        state[_NEW] += 1
        return 0
    for place in range(14):
        if corners[place] == vertex:
            return place + 1
    return _NAMED_BY_NUMBER


@register_jitable(**_INNER)
def _name(vertex: int, state: Whole, data: Bytes) -> None:
    """Name a vertex by its difference from the last named one, 7 bits a byte."""
    change = vertex - state[_LAST]
    left = 2 * change if change >= 0 else -2 * change - 1
    while left >= 128:
        data[state[_SIZE]] = (left & 127) | 128
        left >>= 7
        state[_SIZE] += 1
    data[state[_SIZE]] = left
    state[_SIZE] += 1


@register_jitable(**_INNER)
def _remember(corners: Whole, vertex: int) -> None:
    for place in range(15, 0, -1):
        corners[place] = corners[place - 1]
    corners[0] = vertex


@register_jitable(**_INNER)
def _remember_edge(edges: Whole, start: int, end: int) -> None:
    for place in range(15, 0, -1):
        edges[place, 0], edges[place, 1] = edges[place - 1, 0], edges[place - 1, 1]
    edges[0, 0], edges[0, 1] = start, end
