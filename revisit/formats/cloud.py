"""The result of every parser, and its limits: points, bytes, and compressed bytes.

The cap on the output of zstd and gzip holds while it comes out.
"""

from __future__ import annotations

import zlib
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from revisit.core.errors import BadField, MalformedBody, TooLarge, UnsupportedEncoding

Points = NDArray[np.float32]
Intensity = NDArray[np.float32]
Buffer = bytes | memoryview


@dataclass(frozen=True)
class CloudLimits:
    """How large a body and the cloud inside it may be (docs: limits; reliability section b)."""

    max_body_bytes: int = 32 * 2**20
    max_decoded_bytes: int = 64 * 2**20
    max_ratio: int = 100
    max_points: int = 2_000_000


DEFAULT_LIMITS = CloudLimits()

FAR_M = 8192.0
"""From here on float32 is off by half a millimetre and more."""

MAX_WINDOW_BYTES = 8 * 2**20
ALWAYS_ALLOWED_BYTES = 65_536
# One zstd block of 4 bytes may yield 128 KiB, so small pieces bound the output of one call (16 MiB).
_PIECE_BYTES = 512


@dataclass(frozen=True)
class DecodedCloud:
    """A parsed, not yet validated cloud: points (n, 3) float32 metres, sensor frame; intensity (n,) float32 or None.

    Points may be NaN or infinite; `core.scan.validate_cloud` decides about them.
    """

    points: Points
    intensity: Intensity | None = None

    @classmethod
    def from_columns(
        cls, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], intensity: NDArray[Any] | None
    ) -> DecodedCloud:
        """A cloud of four (n,) numeric columns of any type and byte order; float64 beyond float32 becomes infinite."""
        points = np.empty((len(x), 3), dtype=np.float32)
        with np.errstate(over="ignore", invalid="ignore"):
            points[:, 0], points[:, 1], points[:, 2] = x, y, z
            return cls(points, None if intensity is None else intensity.astype(np.float32))


@dataclass(frozen=True)
class Column:
    """One scalar field of a point record: its name, numpy type code (`<f4`) and byte offset in the record."""

    name: str
    dtype: str
    offset: int


INTENSITY_NAMES = ("intensity", "scalar_intensity", "i", "reflectivity", "reflectance")


def required_columns(columns: dict[str, Column]) -> tuple[list[Column], Column | None]:
    """The x, y and z columns, and the intensity column where there is one.

    Raises BadField where a coordinate is missing, is not float32 or float64, or the three types differ.
    """
    missing = [name for name in "xyz" if name not in columns]
    if missing:
        raise BadField(f"the cloud has no field {' and no field '.join(missing)}", field="points")
    coordinates = [columns[name] for name in "xyz"]
    kinds = {column.dtype.lstrip("<>|=") for column in coordinates}
    if len(kinds) != 1 or not kinds <= {"f4", "f8"}:
        raise BadField("x, y and z must be all float32 or all float64", field="points")
    intensity = next((columns[name] for name in columns if name.lower() in INTENSITY_NAMES), None)
    return coordinates, intensity


def cloud_from_records(body: memoryview, count: int, stride: int, columns: dict[str, Column]) -> DecodedCloud:
    """The cloud in `count` packed records of `stride` bytes; `body` must hold exactly those (checked by the caller)."""
    coordinates, intensity = required_columns(columns)
    records = _records(body, count, stride, [*coordinates, *([intensity] if intensity else [])])
    x, y, z = (records[column.name] for column in coordinates)
    return DecodedCloud.from_columns(x, y, z, records[intensity.name] if intensity else None)


def coordinates_from_records(
    body: memoryview, count: int, stride: int, columns: dict[str, Column]
) -> NDArray[np.float64]:
    """The coordinates (n, 3) alone, of full precision: far from the origin of a map float32 is too coarse."""
    coordinates, _ = required_columns(columns)
    records = _records(body, count, stride, coordinates)
    return np.column_stack([records[column.name].astype(np.float64) for column in coordinates])


def _records(body: memoryview, count: int, stride: int, wanted: list[Column]) -> NDArray[Any]:
    record = np.dtype(
        {
            "names": [column.name for column in wanted],
            "formats": [column.dtype for column in wanted],
            "offsets": [column.offset for column in wanted],
            "itemsize": stride,
        }
    )
    return np.frombuffer(body, dtype=record, count=count)


def require_exact_size(declared: int, present: int, count: int, limits: CloudLimits) -> None:
    """Refuse a body that does not match its header exactly, then one with too many points.

    Python integers, so that nothing overflows, and before anything is allocated. Raises MalformedBody, TooLarge.
    """
    if declared != present:
        raise MalformedBody(f"the header declares {declared} bytes of points, the body holds {present}")
    require_point_count(count, limits)


def require_point_count(count: int, limits: CloudLimits) -> None:
    """Raises TooLarge above the permitted number of points."""
    if count > limits.max_points:
        raise TooLarge(f"a cloud may have {limits.max_points} points, got {count}", field="points")


def checked_for_writing(points: NDArray[np.floating], intensity: NDArray[np.floating] | None) -> DecodedCloud:
    """`points` (n, 3) and `intensity` (n,) as little-endian float32. Raises BadField for other shapes."""
    if points.ndim != 2 or points.shape[1] != 3:
        raise BadField(f"points must be (n, 3), got {points.shape}", field="points")
    if intensity is not None and intensity.shape != (len(points),):
        raise BadField(f"intensity must be ({len(points)},), got {intensity.shape}", field="intensity")
    values = None if intensity is None else np.ascontiguousarray(intensity, dtype="<f4")
    return DecodedCloud(np.ascontiguousarray(points, dtype="<f4"), values)


def records_for_writing(points: NDArray[np.floating], intensity: NDArray[np.floating] | None) -> NDArray[np.void]:
    """`points` (n, 3) and `intensity` (n,) as records (n,) of x, y, z and, where given, intensity, for a file.

    float32, but for coordinates that are given more exactly and lie from `FAR_M` on, as those of a map in UTM do:
    float64. Raises BadField for other shapes.
    """
    cloud = checked_for_writing(points, intensity)
    far = points.dtype == np.float64 and bool((np.abs(cloud.points) >= FAR_M).any())
    kind = "<f8" if far else "<f4"
    columns = [(axis, kind) for axis in "xyz"] + ([] if cloud.intensity is None else [("intensity", "<f4")])
    records = np.empty(len(points), dtype=columns)
    records["x"], records["y"], records["z"] = (points if far else cloud.points).T
    if cloud.intensity is not None:
        records["intensity"] = cloud.intensity
    return records


def kinds_of(records: NDArray[np.void]) -> dict[str, str]:
    """The numpy type code (`<f4`) of each field of records, in their order."""
    return {name: records.dtype[name].str for name in records.dtype.names or ()}


def decode_content(data: bytes, content_encoding: str | None, limits: CloudLimits = DEFAULT_LIMITS) -> bytes:
    """A body without its `Content-Encoding` (none, identity, gzip or zstd; one only).

    Raises UnsupportedEncoding for others, MalformedBody for damaged, truncated, trailing or multi-member data,
    TooLarge above `limits.max_decoded_bytes` or `limits.max_ratio`.
    """
    if len(data) > limits.max_body_bytes:
        raise TooLarge(f"a body may have {limits.max_body_bytes} bytes, got {len(data)}")
    match (content_encoding or "identity").strip().lower():
        case "identity":
            return data
        case "gzip":
            return _gunzip(data, _allowed(data, limits))
        case "zstd":
            return decompress_zstd(data, _allowed(data, limits))
    raise UnsupportedEncoding("Content-Encoding must be one of identity, gzip, zstd", field="Content-Encoding")


def decompress_zstd(data: Buffer, max_bytes: int) -> bytes:
    """The content of one zstd frame without dictionary and with a window of at most 8 MiB.

    Raises MalformedBody, TooLarge above `max_bytes`.
    """
    try:
        announced = _announced_bytes(data, max_bytes)
        if announced is not None:
            with suppress(zstandard.ZstdError):
                return zstandard.ZstdDecompressor().decompress(data, max_output_size=announced, allow_extra_data=False)
        return _decompress_by_pieces(memoryview(data), max_bytes)
    except zstandard.ZstdError as error:
        raise MalformedBody("the zstd data is damaged") from error


def _decompress_by_pieces(data: memoryview, max_bytes: int) -> bytes:
    """For a frame that does not say how much it holds, and to learn what is wrong with one that does not hold it."""
    decompressor = zstandard.ZstdDecompressor(max_window_size=MAX_WINDOW_BYTES).decompressobj()
    pieces, total = [], 0
    for start in range(0, len(data), _PIECE_BYTES):
        piece = decompressor.decompress(data[start : start + _PIECE_BYTES])
        total += len(piece)
        if total > max_bytes:
            raise TooLarge(f"the body decompresses to more than {max_bytes} bytes")
        pieces.append(piece)
        if decompressor.eof:
            _require_end(decompressor.unused_data or data[start + _PIECE_BYTES :])
            return b"".join(pieces)
    raise MalformedBody("the zstd data is truncated")


def _allowed(data: bytes, limits: CloudLimits) -> int:
    return min(limits.max_decoded_bytes, max(limits.max_ratio * len(data), ALWAYS_ALLOWED_BYTES))


def _announced_bytes(data: Buffer, max_bytes: int) -> int | None:
    """How much a permitted frame says that it holds, if it says so; the decompressor writes no byte beyond it."""
    frame = zstandard.get_frame_parameters(data)
    if frame.dict_id or frame.window_size > max(MAX_WINDOW_BYTES, max_bytes):
        raise MalformedBody("the zstd frame needs a dictionary or a window above 8 MiB")
    if frame.content_size == zstandard.CONTENTSIZE_UNKNOWN:
        return None
    if frame.content_size > max_bytes:
        raise TooLarge(f"the body decompresses to more than {max_bytes} bytes")
    return int(frame.content_size)


def _gunzip(data: bytes, max_bytes: int) -> bytes:
    decompressor = zlib.decompressobj(wbits=31)
    try:
        content = decompressor.decompress(data, max_bytes + 1)
    except zlib.error as error:
        raise MalformedBody("the gzip data is damaged") from error
    if len(content) > max_bytes:
        raise TooLarge(f"the body decompresses to more than {max_bytes} bytes")
    if not decompressor.eof:
        raise MalformedBody("the gzip data is truncated")
    _require_end(decompressor.unused_data)
    return content


def _require_end(rest: Buffer) -> None:
    if rest:
        raise MalformedBody(f"{len(rest)} bytes follow the compressed data")
