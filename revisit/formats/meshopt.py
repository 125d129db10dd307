"""Vertices and triangles in the bitstreams of the glTF extension EXT_meshopt_compression.

Written after the extension's specification: no Python package of it is kept up, see decision 0167. Attributes are
stored as differences of bytes in groups of 16, triangles by the edges and vertices that they share with the last ones.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_ATTRIBUTES_HEAD, _TRIANGLES_HEAD = 0xA0, 0xE1
_GROUP = 16
_TAIL_BYTES = 32
_TABLE = 16
"""Common pairs of codes that a list of triangles names once."""
_NAMED = 14

Bytes = NDArray[np.uint8]


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
    _triangles(triangles, table, 0, codes, data, used)
    table[:_NAMED] = np.argsort(-used, kind="stable")[:_NAMED]
    table[used[table] == 0] = 0
    size = _triangles(triangles, table, _NAMED, codes, data, np.zeros(256, np.int64))
    return bytes([_TRIANGLES_HEAD]) + codes.tobytes() + data[:size].tobytes() + table.tobytes()


def along_edges(faces: NDArray[np.integer]) -> NDArray[np.int64]:
    """Triangles (f, 3) in an order in which most share an edge with one of the last."""
    triangles = np.ascontiguousarray(faces, dtype=np.int64)
    return triangles[_walk(_neighbours(triangles))]


def _neighbours(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """For each of the edges of triangles (f, 3), the other triangle at it, -1 for none."""
    ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    keys = ends[:, 0] * (faces.max(initial=0) + 1) + ends[:, 1]
    order = np.argsort(keys, kind="stable")
    pairs = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    found = np.full(len(keys), -1, np.int64)
    found[order[pairs]] = order[pairs + 1] // 3
    found[order[pairs + 1]] = order[pairs] // 3
    return found.reshape(-1, 3)


@njit(nogil=True, cache=True)
def _walk(neighbours: NDArray[np.int64]) -> NDArray[np.int64]:
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


def in_order_of_use(
    vertices: NDArray[np.floating], faces: NDArray[np.integer]
) -> tuple[NDArray[np.floating], NDArray[np.int64]]:
    """The vertices that faces name, in the order in which they first do, and the faces with their new numbers."""
    used, first, named = np.unique(faces, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    return vertices[used[order]], rank[named.reshape(faces.shape)]


@njit(nogil=True, cache=True)
def _attributes(rows: Bytes, out: Bytes) -> int:
    """Bytes written to `out`: blocks of rows, in them one byte of all rows after the other."""
    count, stride = rows.shape
    block = min((8192 // stride) & ~15, 256)
    written = 0
    for start in range(0, count, block):
        end = min(start + block, count)
        for column in range(stride):
            written = _column(rows, start, end, column, out, written)
    return written


@njit(nogil=True, cache=True)
def _column(rows: Bytes, start: int, end: int, column: int, out: Bytes, written: int) -> int:
    """One byte of the rows of a block, each as its difference from the row before. Where the next goes."""
    groups = (end - start + _GROUP - 1) // _GROUP
    head = written
    written += (groups + 3) // 4
    deltas = np.zeros(_GROUP, np.uint8)
    for group in range(groups):
        first = start + group * _GROUP
        deltas[:] = 0
        for row in range(first, min(first + _GROUP, end)):
            before = rows[max(row - 1, 0), column]
            change = (np.int64(rows[row, column]) - np.int64(before)) & 255
            deltas[row - first] = (change << 1) & 255 if change < 128 else 511 - 2 * change
        mode, bits = _cheapest(deltas)
        out[head + group // 4] |= mode << (2 * (group % 4))
        written = _group(deltas, bits, out, written)
    return written


@njit(nogil=True, cache=True)
def _cheapest(deltas: Bytes) -> tuple[int, int]:
    """Mode and bits a difference: larger ones are stored behind the group."""
    if deltas.max() == 0:
        return 0, 0
    with_two, with_four = 4 + np.sum(deltas >= 3), 8 + np.sum(deltas >= 15)
    if with_two <= with_four and with_two < _GROUP:
        return 1, 2
    return (2, 4) if with_four < _GROUP else (3, 8)


@njit(nogil=True, cache=True)
def _group(deltas: Bytes, bits: int, out: Bytes, written: int) -> int:
    """16 differences with so many bits each; where the next group goes."""
    if bits == 0:
        return written
    if bits == 8:
        out[written : written + _GROUP] = deltas
        return written + _GROUP
    large, each = (1 << bits) - 1, 8 // bits
    behind = written + _GROUP // each
    for number in range(_GROUP):
        shift = bits * (each - 1 - number % each)
        out[written + number // each] |= np.int64(min(deltas[number], large)) << shift
        if deltas[number] >= large:
            out[behind] = deltas[number]
            behind += 1
    return behind


@njit(nogil=True, cache=True)
def _triangles(
    faces: NDArray[np.int64], table: Bytes, named: int, codes: Bytes, data: Bytes, used: NDArray[np.int64]
) -> int:
    """Bytes of `data`; `used` counts the pairs of codes that the first `named` entries of the table could name."""
    edges, corners = np.full((16, 2), -1, np.int64), np.full(16, -1, np.int64)
    state = np.zeros(2, np.int64)  # the next new vertex, the last one named by its number
    size = 0
    for number in range(len(faces)):
        edge, turn = _shared_edge(edges, faces[number])
        if edge >= 0:
            a, b, c = faces[number, turn], faces[number, (turn + 1) % 3], faces[number, (turn + 2) % 3]
            code, size = _third_corner(c, corners, state, data, size)
            codes[number] = (edge << 4) | code
        else:
            turn = _first_corner(faces[number], state[0])
            a, b, c = faces[number, turn], faces[number, (turn + 1) % 3], faces[number, (turn + 2) % 3]
            codes[number], size = _free(a, b, c, corners, state, table[:named], data, size, used)
            _remember_edge(edges, b, a)
        _remember_edge(edges, c, b)
        _remember_edge(edges, a, c)
    return size


@njit(nogil=True, cache=True)
def _shared_edge(edges: NDArray[np.int64], face: NDArray[np.int64]) -> tuple[int, int]:
    """The latest of the last 15 edges that a triangle shares, and the corner at which it begins; -1 for none."""
    for edge in range(15):
        for turn in range(3):
            if edges[edge, 0] == face[turn] and edges[edge, 1] == face[(turn + 1) % 3]:
                return edge, turn
    return -1, 0


@njit(nogil=True, cache=True)
def _first_corner(face: NDArray[np.int64], new: int) -> int:
    """The corner that is the next new vertex, else the first one."""
    for turn in range(3):
        if face[turn] == new:
            return turn
    return 0


@njit(nogil=True, cache=True)
def _third_corner(
    c: int, corners: NDArray[np.int64], state: NDArray[np.int64], data: Bytes, size: int
) -> tuple[int, int]:
    """The code of the corner opposite to a shared edge: new, one of the last, beside the last named, or named."""
    if c == state[0]:
        state[0] += 1
        _remember(corners, c)
        return 0, size
    for place in range(1, 13):
        if corners[place] == c:
            return place, size
    code = 13 if c == state[1] - 1 else 14 if c == state[1] + 1 else 15
    if code == 15:
        size = _number(c, state, data, size)
    state[1] = c
    _remember(corners, c)
    return code, size


@njit(nogil=True, cache=True)
def _free(
    a: int, b: int, c: int, corners: NDArray[np.int64], state: NDArray[np.int64], table: Bytes, data: Bytes, size: int,
    used: NDArray[np.int64],
) -> tuple[int, int]:  # fmt: skip
    """The code of a triangle without a shared edge: its corners are new, among the last 14, or named by number."""
    first = _corner(a, corners, state, 0)
    second = _corner(b, corners, state, 14)
    # Both 0 behind a first one that is not new would tell the reader to begin anew.
    third = 15 if first == 15 and second == 0 else _corner(c, corners, state, 14)
    pair = (second << 4) | third
    code = 255 if first == 15 else 254
    if first == 0 and 15 not in (second, third):
        used[pair] += 1
        for place in range(len(table)):
            if table[place] == pair:
                code = 240 + place
                break
    if code >= 254:
        data[size] = pair
        size += 1
    for corner, how in ((a, first), (b, second), (c, third)):
        if how == 15:
            size = _number(corner, state, data, size)
            state[1] = corner
        if how in (0, 15):
            _remember(corners, corner)
    return code, size


@njit(nogil=True, cache=True)
def _corner(vertex: int, corners: NDArray[np.int64], state: NDArray[np.int64], known: int) -> int:
    """0 for the next new vertex, 1 to `known` for one of the last, 15 for one that must be named."""
    if vertex == state[0]:
        state[0] += 1
        return 0
    for place in range(known):
        if corners[place] == vertex:
            return place + 1
    return 15


@njit(nogil=True, cache=True)
def _number(vertex: int, state: NDArray[np.int64], data: Bytes, size: int) -> int:
    """Name a vertex by its difference from the last named one, 7 bits a byte. Where the next byte goes."""
    change = vertex - state[1]
    left = 2 * change if change >= 0 else -2 * change - 1
    while left >= 128:
        data[size] = (left & 127) | 128
        left >>= 7
        size += 1
    data[size] = left
    return size + 1


@njit(nogil=True, cache=True)
def _remember(corners: NDArray[np.int64], vertex: int) -> None:
    corners[1:] = corners[:-1].copy()
    corners[0] = vertex


@njit(nogil=True, cache=True)
def _remember_edge(edges: NDArray[np.int64], start: int, end: int) -> None:
    edges[1:] = edges[:-1].copy()
    edges[0, 0], edges[0, 1] = start, end
