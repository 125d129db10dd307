"""Quantised clouds, `application/vnd.revisit.quantised`: 1 mm integers, differences along rays, byte planes, zstd.

    offset  type   meaning (little-endian)
    0       4s     magic "RVQ2"
    4       u32    number of points n
    8       f32    step of a coordinate in metres: 0.001, or a multiple of it where all are multiples of that
    12      f32    step of an intensity; 0 where the cloud has none
    16      u8     how b is expected: 0, 1 or 2 (`revisit.formats.ray_prediction`)
    17      u8     how z is expected
    18      u16    zero
    20             one zstd frame of n x 12 bytes, or n x 14 with intensity

The frame holds three columns of coordinates, then intensity. The first is the difference of the coordinate a to the
point before, where a is x if |x| >= |y| at the point before, else y; the second is what b, the other one of x and y,
differs from what is expected, the third z. A column is zigzag-coded (uint32; uint16 for intensity, the difference
modulo 2^16) and stored as byte planes: all lowest bytes first, all highest last. Coordinates are round(value / step),
at most 2^24. Lossy: half a step, 0.5 mm. Non-finite points cannot be written.
"""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from revisit.core.errors import BadField, MalformedBody, OutOfRange
from revisit.formats.cloud import CloudLimits, DecodedCloud, checked_for_writing, decompress_zstd, require_point_count
from revisit.formats.ray_prediction import Prediction, residuals

MAGIC = b"RVQ2"
STEP_M = 0.001
MAX_COORDINATE_M = 10_000.0
_MAX_STEP = 1_000  # a step has a metre at most
ZSTD_LEVEL = 3

_HEADER = struct.Struct("<4sIffBBH")


def encode(points: NDArray[np.floating], intensity: NDArray[np.floating] | None = None) -> bytes:
    """Quantise finite points (n, 3) in metres and, where given, non-negative intensity (n,).

    Raises BadField for non-finite numbers or negative intensities, OutOfRange beyond 10 km.
    """
    cloud = checked_for_writing(points, intensity)
    if not np.isfinite(cloud.points).all():
        raise BadField("non-finite points cannot be quantised", field="points")
    if cloud.points.size and float(np.abs(cloud.points).max()) > MAX_COORDINATE_M:
        raise OutOfRange(field="points")
    grid, step = _coarsest(np.rint(cloud.points.astype(np.float64) / STEP_M))
    coordinates, of_side, of_height = residuals(grid)
    columns = [_planes(_zigzag(column.astype(np.int32))) for column in coordinates]  # each less than 2^31
    intensity_step = 0.0
    if cloud.intensity is not None:
        intensity_step, levels = _quantise_intensity(cloud.intensity)
        columns.append(_planes(_zigzag(np.diff(levels, prepend=0).astype(np.int16))))
    header = _HEADER.pack(MAGIC, len(grid), step, intensity_step, of_side, of_height, 0)
    return header + zstandard.ZstdCompressor(ZSTD_LEVEL, write_checksum=True).compress(b"".join(columns))


def decode(data: bytes, limits: CloudLimits) -> DecodedCloud:
    """The points on their grid. Raises MalformedBody, TooLarge."""
    count, step, intensity_step, predictions = _head(data)
    if not 0.0 < step <= 1.0 or not (math.isfinite(intensity_step) and intensity_step >= 0.0):
        raise MalformedBody("a quantised cloud has an impossible step")
    require_point_count(count, limits)
    size = count * (14 if intensity_step else 12)
    content = memoryview(decompress_zstd(memoryview(data)[_HEADER.size :], size))
    if len(content) != size:
        raise MalformedBody(f"{count} quantised points need {size} bytes, the frame holds {len(content)}")
    from revisit.formats import quantised_columns as columns  # numba takes long to import, and clients decode nothing

    planes = np.frombuffer(content, dtype=np.uint8)
    # The header's step is float32; the grid is meant in exact steps such as 0.001.
    step = round(step, 9)
    points, right = columns.coordinates_on_rays(planes, count, step, *predictions)
    if not right:
        raise MalformedBody("a quantised cloud has a coordinate beyond 2^24 steps")
    if not intensity_step:
        return DecodedCloud(points)
    return DecodedCloud(points, columns.intensities(planes[12 * count :], count, intensity_step))


def count(data: bytes) -> int:
    """The number of points, all of them finite, that the head announces. Raises MalformedBody."""
    return _head(data)[0]


def _head(data: bytes) -> tuple[int, float, float, tuple[Prediction, Prediction]]:
    """Number of points, step, step of intensities, and how b and z are expected. Raises MalformedBody."""
    if not data.startswith(MAGIC) or len(data) < _HEADER.size:
        raise MalformedBody("the body is not a quantised cloud of this version")
    _, count, step, intensity_step, of_side, of_height, rest = _HEADER.unpack_from(data)
    if rest or max(of_side, of_height) > max(Prediction):
        raise MalformedBody("a quantised cloud has a prediction that is not known")
    return count, step, intensity_step, (Prediction(of_side), Prediction(of_height))


def _coarsest(millimetres: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Points (n, 3) in whole steps, and the step in metres: the largest of which all coordinates are multiples."""
    whole = np.ravel(millimetres[:: max(1, len(millimetres) // 64)]).astype(np.int64)
    times = int(np.gcd.reduce(whole))
    if times > 1:
        times = int(np.gcd.reduce(np.ravel(millimetres).astype(np.int64)))
    if not 1 < times <= _MAX_STEP:
        return millimetres, STEP_M
    return millimetres / times, STEP_M * times


def _quantise_intensity(intensity: NDArray[np.float32]) -> tuple[float, NDArray[np.int64]]:
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
