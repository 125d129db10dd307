"""Quantised clouds, `application/vnd.revisit.quantised`: 1 mm integers, differences along rays, byte planes, zstd.

    offset  type   meaning (little-endian)
    0       4s     magic "RVQ2"
    4       u32    number of points n
    8       f32    step of a coordinate in metres: 0.001, or a multiple of it where all are multiples of that
    12      f32    step of an intensity; 0 where the cloud has none
    16      u8     how b is expected: 0, 1 or 2 (`revisit.formats.ray_prediction`)
    17      u8     how z is expected
    18      u16    further columns: 1 ring, 2 time, 4 colour; else zero
    20             one zstd frame of n x 12 bytes; 2 more with intensity, 2 with ring, 4 with time, 3 with colour

The frame holds three columns of coordinates, then intensity, ring, time, red, green and blue, where there are such. The
first is the difference of the coordinate a to the point before, where a is x if |x| >= |y| at the point before, else y;
the second is what b, the other one of x and y, differs from what is expected, the third z. A further column is the
difference to the point before: of intensity and ring modulo 2^16, of the time since the stamp, in microseconds, modulo
2^32, of a colour modulo 2^8. A column is zigzag-coded and stored as byte planes: all lowest bytes first, all highest
last. Coordinates are round(value / step), at most 2^24. Lossy: half a step, 0.5 mm, and half a microsecond. Non-finite
points cannot be written.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Collection
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from revisit.core.errors import BadField, MalformedBody, OutOfRange
from revisit.core.point_columns import COLUMNS, INTENSITY, NONE, Columns, PointColumn
from revisit.formats.cloud import CloudLimits, DecodedCloud, checked_for_writing, decompress_zstd, require_point_count
from revisit.formats.ray_prediction import Prediction, residuals

MAGIC = b"RVQ2"
STEP_M = 0.001
MAX_COORDINATE_M = 10_000.0
_MAX_STEP = 1_000  # a step has a metre at most
ZSTD_LEVEL = 3

_COORDINATE_BYTES = 12

_FURTHER = {name: 1 << bit for bit, name in enumerate(name for name in COLUMNS if name != INTENSITY.name)}
"""The bit of the header that says that a cloud has the column."""

_HEADER = struct.Struct("<4sIffBBH")


def encode(points: NDArray[np.floating], columns: Columns = NONE) -> bytes:
    """Quantise finite points (n, 3) in metres and their columns.

    Raises BadField for non-finite numbers, negative intensities and columns out of range, OutOfRange beyond 10 km.
    """
    cloud = checked_for_writing(points, columns)
    if not np.isfinite(cloud.points).all():
        raise BadField("non-finite points cannot be quantised", field="points")
    if cloud.points.size and float(np.abs(cloud.points).max()) > MAX_COORDINATE_M:
        raise OutOfRange(field="points")
    grid, step = _coarsest(np.rint(cloud.points.astype(np.float64) / STEP_M))
    coordinates, of_side, of_height = residuals(grid)
    parts = [_planes(_zigzag(column.astype(np.int32))) for column in coordinates]  # each less than 2^31
    intensity_step, further = 0.0, 0
    for name in (name for name in COLUMNS if name in columns):
        if name == INTENSITY.name:
            intensity_step, levels = _quantise_intensity(columns[name])
        else:
            further |= _FURTHER[name]
            levels = _levels(COLUMNS[name], columns[name])
        parts += _coded(COLUMNS[name], levels)
    header = _HEADER.pack(MAGIC, len(grid), step, intensity_step, of_side, of_height, further)
    return header + zstandard.ZstdCompressor(ZSTD_LEVEL, write_checksum=True).compress(b"".join(parts))


def _levels(column: PointColumn, values: NDArray[Any]) -> NDArray[np.int64]:
    """The values in whole steps. Raises BadField for those that the column does not hold."""
    if not column.holds(values):
        raise BadField(f"{column.name} must be whole numbers, {column.low:,} to {column.high:,}", field=column.name)
    return np.rint(values / (column.step or 1)).astype(np.int64)


def _coded(column: PointColumn, levels: NDArray[np.int64]) -> list[bytes]:
    """The byte planes of a column, of each of its channels."""
    differences = np.diff(levels.reshape(len(levels), column.channels), axis=0, prepend=0)
    return [_planes(_zigzag(one.astype(f"<i{column.coded_bytes}"))) for one in differences.T]


def decode(data: bytes, limits: CloudLimits, wanted: Collection[str] = tuple(COLUMNS)) -> DecodedCloud:
    """The points on their grid, and those of their columns that are wanted. Raises MalformedBody, TooLarge."""
    count, step, intensity_step, predictions, columns = _head(data)
    if not 0.0 < step <= 1.0 or not (math.isfinite(intensity_step) and intensity_step >= 0.0):
        raise MalformedBody("a quantised cloud has an impossible step")
    require_point_count(count, limits)
    size = count * (_COORDINATE_BYTES + sum(one.coded_bytes * one.channels for one in columns))
    content = memoryview(decompress_zstd(memoryview(data)[_HEADER.size :], size))
    if len(content) != size:
        raise MalformedBody(f"{count} quantised points need {size} bytes, the frame holds {len(content)}")
    from revisit.formats import quantised_columns  # numba takes long to import, and clients decode nothing

    planes = np.frombuffer(content, dtype=np.uint8)
    # The header's step is float32; the grid is meant in exact steps such as 0.001.
    points, right = quantised_columns.coordinates_on_rays(planes, count, round(step, 9), *predictions)
    if not right:
        raise MalformedBody("a quantised cloud has a coordinate beyond 2^24 steps")
    found, at = dict[str, NDArray[Any]](), _COORDINATE_BYTES * count
    for column in columns:
        size = column.coded_bytes * count
        ends = [at + size * channel for channel in range(column.channels + 1)]
        if column.name in wanted:
            channels = [quantised_columns.levels(planes[one:], count, column.coded_bytes) for one in ends[:-1]]
            found[column.name] = _values(column, channels, intensity_step)
        at = ends[-1]
    return DecodedCloud(points, found)


def _values(column: PointColumn, channels: list[NDArray[np.uint32]], intensity_step: float) -> NDArray[Any]:
    """The values of whole steps. Raises MalformedBody for those that the column does not hold."""
    if column.step is None:
        return (channels[0] * intensity_step).astype(np.float32)
    signed = channels[0].view(np.int32) if column.low < 0 else np.stack(channels, axis=-1)
    values = signed.astype(np.int64).reshape((-1, column.channels) if column.channels > 1 else -1) * column.step
    if not column.holds(values):
        raise MalformedBody(f"a quantised cloud has a {column.name} that is not {column.low:,} to {column.high:,}")
    return values.astype(column.kind)


def count(data: bytes) -> int:
    """The number of points, all of them finite, that the head announces. Raises MalformedBody."""
    return _head(data)[0]


def _head(data: bytes) -> tuple[int, float, float, tuple[Prediction, Prediction], list[PointColumn]]:
    """Number of points, step, step of intensities, how b and z are expected, and the columns. Raises MalformedBody."""
    if not data.startswith(MAGIC) or len(data) < _HEADER.size:
        raise MalformedBody("the body is not a quantised cloud of this version")
    _, count, step, intensity_step, of_side, of_height, further = _HEADER.unpack_from(data)
    if further > sum(_FURTHER.values()) or max(of_side, of_height) > max(Prediction):
        raise MalformedBody("a quantised cloud has a prediction or a column that is not known")
    present = {name for name, bit in _FURTHER.items() if further & bit} | (
        {INTENSITY.name} if intensity_step else set()
    )
    columns = [one for name, one in COLUMNS.items() if name in present]
    return count, step, intensity_step, (Prediction(of_side), Prediction(of_height)), columns


def _coarsest(millimetres: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Points (n, 3) in whole steps, and the step in metres: the largest of which all coordinates are multiples."""
    whole = np.ravel(millimetres[:: max(1, len(millimetres) // 64)]).astype(np.int64)
    times = int(np.gcd.reduce(whole))
    if times > 1:
        times = int(np.gcd.reduce(np.ravel(millimetres).astype(np.int64)))
    if not 1 < times <= _MAX_STEP:
        return millimetres, STEP_M
    return millimetres / times, STEP_M * times


def _quantise_intensity(intensity: NDArray[np.floating]) -> tuple[float, NDArray[np.int64]]:
    if not np.isfinite(intensity).all() or (intensity < 0).any():
        raise BadField("an intensity must be finite and not negative to be quantised", field="intensity")
    largest = float(intensity.max(initial=0.0))
    step = float(np.float32(largest / 65_535)) if largest > 1e-30 else 1.0
    return step, np.clip(np.rint(intensity.astype(np.float64) / step), 0, 65_535).astype(np.int64)


def _zigzag(signed: NDArray[np.signedinteger[Any]]) -> NDArray[np.unsignedinteger[Any]]:
    """0, -1, 1, -2, ... as 0, 1, 2, 3, ..., of the same size."""
    bits = 8 * signed.itemsize
    return ((signed << 1) ^ (signed >> (bits - 1))).astype(f"<u{signed.itemsize}")


def _planes(column: NDArray[Any]) -> bytes:
    """The bytes of `column`, all lowest bytes first."""
    return column.view(np.uint8).reshape(len(column), column.itemsize).T.tobytes()
