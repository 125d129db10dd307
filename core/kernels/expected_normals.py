"""The normal that the voxels around one let expect, in whole numbers: as `oriented_normals` computes it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, inner
from revisit.core.kernels.plane_guesses import FIXED

Whole = NDArray[np.int32]
Numbers = NDArray[np.int64]

FLATNESSES = 7
"""Classes of how flat the surface around a voxel is; the first where there is no other voxel."""
NORMAL_A, NORMAL_B, VIEW_A, VIEW_B, OCCUPIED, FLATNESS, MEAN = range(7)
"""Indices of the result of `expect_normal`: codes of the normal and of the direction to the middle of the map, how many
voxels are beside, class of flatness, and from here on the sum (3) of the places around in parts of FIXED, and that of
their weights.
"""
EXPECTED = MEAN + 4

_WEIGHTS = np.rint(256 * np.exp(-0.5 * np.arange(64) / (16 * 0.7**2))).astype(np.int64)
"""By the squared distance in sixteenths of that of a voxel's edge: as `elastic_points` pools returns."""
_OF_HITS = np.array([2, 3, 4, 6])
_OF_UNKNOWN = 3
_FINE = 20
_PRIOR = round(0.05 * (1 << _FINE))
"""The view counts as this part of the spread: `oriented_normals.NORMAL_PRIOR`."""
_SQUARINGS = 4
_BITS = 20
_VIEW = 1 << 10


@inner
def expect_normal(
    around: Whole, count: int, row: int, voxels: Whole, low: Numbers, spots: Whole, codes: Whole, steps: int,
    expected: Numbers,
) -> None:  # fmt: skip
    """Fill `expected` (EXPECTED,) for the voxel of `row`, beside which are those of the first `count` rows `around`.

    spots (n, 3) are where points lie in their voxels, zero where that is not known yet, in parts of FIXED; codes (n, 4)
    hold the class of hits last, known up to the row's own. `low` (3,) is voxel 0 as seen from the middle of the map.
    """
    x, y, z = -2 * (voxels[row, 0] + low[0]) - 1, -2 * (voxels[row, 1] + low[1]) - 1, -2 * (voxels[row, 2] + low[2]) - 1
    expected[VIEW_A], expected[VIEW_B] = octahedral_code(x, y, z, steps)
    expected[NORMAL_A], expected[NORMAL_B] = expected[VIEW_A], expected[VIEW_B]
    expected[OCCUPIED], expected[FLATNESS] = count, 0
    while max(abs(x), abs(y), abs(z)) >= _VIEW:
        x, y, z = x >> 1, y >> 1, z >> 1
    xx, xy, xz, yy, yz, zz = _covariance(around, count, row, voxels, spots, codes, expected)
    spread = xx + yy + zz
    if spread > 0:
        part = spread * _PRIOR >> _FINE
        along = (part << _FINE) // (x * x + y * y + z * z)
        xx, xy, xz = xx + part - (along * x * x >> _FINE), xy - (along * x * y >> _FINE), xz - (along * x * z >> _FINE)
        yy, yz, zz = (
            yy + part - (along * y * y >> _FINE),
            yz - (along * y * z >> _FINE),
            zz + part - (along * z * z >> _FINE),
        )
        nx, ny, nz = least_axis(xx, xy, xz, yy, yz, zz)
        if nx * x + ny * y + nz * z < 0:
            nx, ny, nz = -nx, -ny, -nz
        expected[NORMAL_A], expected[NORMAL_B] = octahedral_code(nx, ny, nz, steps)
        across = nx * nx * xx + ny * ny * yy + nz * nz * zz + 2 * (nx * ny * xy + nx * nz * xz + ny * nz * yz)
        expected[FLATNESS] = _flatness(64 * across // (max(nx * nx + ny * ny + nz * nz, 1) * spread))


@inlined
def _covariance(
    around: Whole, count: int, row: int, voxels: Whole, spots: Whole, codes: Whole, expected: Numbers
) -> tuple[int, int, int, int, int, int]:
    """The covariance (00, 01, 02, 11, 12, 22) around the voxel, its trace below 2^_BITS; `expected` gets the sum."""
    total, sx, sy, sz = 256 * _OF_HITS[codes[row, 3]], 0, 0, 0
    xx, xy, xz, yy, yz, zz = 0, 0, 0, 0, 0, 0
    for k in range(count):
        other = around[k]
        dx = (voxels[other, 0] - voxels[row, 0]) * FIXED + spots[other, 0]
        dy = (voxels[other, 1] - voxels[row, 1]) * FIXED + spots[other, 1]
        dz = (voxels[other, 2] - voxels[row, 2]) * FIXED + spots[other, 2]
        weight = _WEIGHTS[min((dx * dx + dy * dy + dz * dz) >> 16, len(_WEIGHTS) - 1)]
        weight *= _OF_HITS[codes[other, 3]] if other < row else _OF_UNKNOWN
        total, sx, sy, sz = total + weight, sx + weight * dx, sy + weight * dy, sz + weight * dz
        xx, xy, xz = xx + weight * dx * dx, xy + weight * dx * dy, xz + weight * dx * dz
        yy, yz, zz = yy + weight * dy * dy, yz + weight * dy * dz, zz + weight * dz * dz
    expected[MEAN], expected[MEAN + 1], expected[MEAN + 2], expected[MEAN + 3] = sx, sy, sz, total
    xx, xy, xz = xx * total - sx * sx, xy * total - sx * sy, xz * total - sx * sz
    yy, yz, zz = yy * total - sy * sy, yz * total - sy * sz, zz * total - sz * sz
    shift = _excess(xx + yy + zz, _BITS)
    return xx >> shift, xy >> shift, xz >> shift, yy >> shift, yz >> shift, zz >> shift


@inlined
def _flatness(thickness: int) -> int:
    """The class of a surface by the share of its spread across it, in parts of 64."""
    size = 1
    while size < FLATNESSES - 1 and thickness > 0:
        thickness >>= 1
        size += 1
    return size


@inner
def least_axis(xx: int, xy: int, xz: int, yy: int, yz: int, zz: int) -> tuple[int, int, int]:
    """The direction of least variance of a covariance below 2^21, in numbers below 2^13: the adjugate's greatest axis,
    which grows beyond the others as it is squared.
    """
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    for turn in range(_SQUARINGS + 1):
        most = max(max(abs(a), abs(d), abs(f)), max(abs(b), abs(c), abs(e)))
        shift = _excess(most, _BITS)
        a, b, c, d, e, f = a >> shift, b >> shift, c >> shift, d >> shift, e >> shift, f >> shift
        if turn < _SQUARINGS:
            a, b, c, d, e, f = (
                a * a + b * b + c * c, a * b + b * d + c * e, a * c + b * e + c * f,
                b * b + d * d + e * e, b * c + d * e + e * f, c * c + e * e + f * f,
            )  # fmt: skip
    if a >= d and a >= f:
        x, y, z = a, b, c
    elif d >= f:
        x, y, z = b, d, e
    else:
        x, y, z = c, e, f
    shift = _excess(max(abs(x), abs(y), abs(z)), 13)
    return x >> shift, y >> shift, z >> shift


@inlined
def _excess(value: int, bits: int) -> int:
    """By how many bits, in fours, a number of at most 63 must be shorter to have no more than so many."""
    shift = 0
    while value >> shift >= 1 << bits:
        shift += 4
    return shift


@inlined
def octahedral_code(x: int, y: int, z: int, steps: int) -> tuple[int, int]:
    """The octahedral code of a direction in whole numbers below 2^34, as `geometry.octahedral.encode` rounds it."""
    length = max(abs(x) + abs(y) + abs(z), 1)
    first, second = x, y
    if z < 0:
        first = length - abs(y) if x >= 0 else abs(y) - length
        second = length - abs(x) if y >= 0 else abs(x) - length
    twice = 2 * length
    return (2 * (first + length) * steps + length) // twice, (2 * (second + length) * steps + length) // twice


@inlined
def settle_spot(spots: Whole, row: int, normal: Whole, height: int) -> None:
    """Where the point of a plane `height` parts of FIXED along a `normal` lies in its voxel: about the spot nearest to
    the middle (`settled_planes`).
    """
    half = FIXED // 2 - 1
    x, y, z, rest = 0, 0, 0, height
    for _ in range(3):
        x, y, z = x + normal[0] * rest // FIXED, y + normal[1] * rest // FIXED, z + normal[2] * rest // FIXED
        x, y, z = min(max(x, -half), half), min(max(y, -half), half), min(max(z, -half), half)
        rest = height - (x * normal[0] + y * normal[1] + z * normal[2]) // FIXED
    spots[row, 0], spots[row, 1], spots[row, 2] = x, y, z
