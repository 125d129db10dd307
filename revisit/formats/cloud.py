"""The result of every parser, and its limits: points, bytes, and compressed bytes.

The cap on the output of zstd and gzip holds while it comes out.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from revisit.core.errors import BadField, MalformedBody, TooLarge, UnsupportedEncoding
from revisit.core.point_columns import INTENSITY, RGB, RING, TIME, USUAL, Columns, column

Points = NDArray[np.float32]
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
    """A parsed, not yet validated cloud: points (n, 3) float32 metres, sensor frame, and `columns` of theirs.

    Points may be NaN or infinite; `core.scan.validate_cloud` decides about them. A column has the values of the file:
    a time in its unit, unless the cloud is quantised.
    """

    points: Points
    columns: Columns = field(default_factory=dict)

    @classmethod
    def of_table(cls, table: NDArray[np.float32]) -> DecodedCloud:
        """The cloud of rows (n, 3) of coordinates, or (n, 4) with intensity."""
        columns = {INTENSITY.name: table[:, 3].copy()} if table.shape[1] == 4 else {}
        return cls(np.ascontiguousarray(table[:, :3]), columns)

    @classmethod
    def from_fields(
        cls, fields: dict[str, Column], wanted: Collection[str], read: Callable[[Column], NDArray[Any]]
    ) -> DecodedCloud:
        """The cloud in such fields, with the columns that are `wanted` and there; `read` gives the values (n,) of one.

        float64 beyond float32 becomes infinite. Raises BadField as `coordinates_of`.
        """
        x, y, z = (read(one) for one in coordinates_of(fields))
        points = np.empty((len(x), 3), dtype=np.float32)
        with np.errstate(over="ignore", invalid="ignore"):
            points[:, 0], points[:, 1], points[:, 2] = x, y, z
        return cls(points, columns_from_fields(fields, wanted, read))


@dataclass(frozen=True)
class Column:
    """One scalar field of a point record: its name, numpy type code (`<f4`) and byte offset in the record."""

    name: str
    dtype: str
    offset: int


TIME_FIELDS = ("t", "time", "timestamp", "offset_time", "time_stamp", "time_offset")
"""Ouster `t`, Velodyne `time`, Hesai and RoboSense `timestamp`, Livox `offset_time` and `timestamp`."""

_NAMES = {
    INTENSITY.name: ("intensity", "scalar_intensity", "i", "reflectivity", "reflectance"),
    RING.name: ("ring", "channel", "line", "laser_id"),
    TIME.name: TIME_FIELDS,
    RGB.name: ("rgb", "rgba"),
}
"""The fields, in small letters, that hold a column; colours in one field are four bytes, 0xAARRGGBB (PCL)."""

_APART = (("red", "green", "blue"), ("r", "g", "b"))


def field_names(wanted: Collection[str]) -> tuple[str, ...]:
    """The names, in small letters, of all fields that such columns are read of."""
    apart = [name for names in _APART for name in names] if RGB.name in wanted else []
    return (*(name for one in wanted for name in _NAMES[column(one).name]), *apart)


def coordinates_of(fields: dict[str, Column]) -> list[Column]:
    """The x, y and z fields. Raises BadField where one is missing, is no float32 or float64, or the types differ."""
    missing = [name for name in "xyz" if name not in fields]
    if missing:
        raise BadField(f"the cloud has no field {' and no field '.join(missing)}", field="points")
    coordinates = [fields[name] for name in "xyz"]
    kinds = {one.dtype.lstrip("<>|=") for one in coordinates}
    if len(kinds) != 1 or not kinds <= {"f4", "f8"}:
        raise BadField("x, y and z must be all float32 or all float64", field="points")
    return coordinates


def sources_of(fields: dict[str, Column], wanted: Collection[str]) -> dict[str, list[Column]]:
    """The fields that the wanted columns are read of, by the name of the column; of those columns that are there."""
    found = {
        name: [one for one in fields.values() if one.name.lower() in _NAMES[column(name).name]][:1] for name in wanted
    }
    if RGB.name in found:
        packed = [one for one in found[RGB.name] if one.dtype.endswith("4")]
        found[RGB.name] = packed or _colours_apart({one.name.lower(): one for one in fields.values()})
    return {name: those for name, those in found.items() if those}


def needed_fields(fields: dict[str, Column], wanted: Collection[str]) -> list[Column]:
    """The fields of the coordinates and of the columns that are wanted and there. Raises BadField."""
    return [*coordinates_of(fields), *(one for those in sources_of(fields, wanted).values() for one in those)]


def _colours_apart(fields: dict[str, Column]) -> list[Column]:
    return next(([fields[name] for name in names] for names in _APART if fields.keys() >= set(names)), [])


def columns_from_fields(
    fields: dict[str, Column], wanted: Collection[str], read: Callable[[Column], NDArray[Any]]
) -> Columns:
    """The columns that are wanted and there; `read` gives the values (n,) of a field."""
    return {
        name: _value(name, those, [read(one) for one in those]) for name, those in sources_of(fields, wanted).items()
    }


def _value(name: str, fields: list[Column], values: list[NDArray[Any]]) -> NDArray[Any]:
    """A column (n,), or (n, 3) of colours, of the values of its fields: a time is float64 or int64, as it is given."""
    kind = fields[0].dtype[1:]
    with np.errstate(over="ignore", invalid="ignore"):
        if name == INTENSITY.name:
            return values[0].astype(np.float32)
        if name == TIME.name:
            return values[0].astype(np.float64 if kind.startswith("f") else np.int64)
        if name == RGB.name and len(values) == 1:
            bits = values[0].astype(f"<{kind}").view("<u4")
            return np.stack([bits >> 16, bits >> 8, bits], axis=1).astype(np.uint8)
    return values[0] if len(values) == 1 else np.column_stack(values)


def cloud_from_records(
    body: memoryview, count: int, stride: int, fields: dict[str, Column], wanted: Collection[str] = USUAL
) -> DecodedCloud:
    """The cloud in `count` packed records of `stride` bytes; `body` must hold exactly those (checked by the caller)."""
    return DecodedCloud.from_fields(fields, wanted, lambda one: field_of_records(body, count, stride, one))


def field_of_records(body: memoryview | bytes, count: int, stride: int, field: Column) -> NDArray[Any]:
    """One field (n,) of such records."""
    record = np.dtype({"names": ["it"], "formats": [field.dtype], "offsets": [field.offset], "itemsize": stride})
    rows: NDArray[np.void] = np.frombuffer(body, record, count)
    return rows["it"]


def coordinates_from_records(
    body: memoryview, count: int, stride: int, fields: dict[str, Column]
) -> NDArray[np.float64]:
    """The coordinates (n, 3) alone, of full precision: far from the origin of a map float32 is too coarse."""
    told = (field_of_records(body, count, stride, one) for one in coordinates_of(fields))
    return np.column_stack([values.astype(np.float64) for values in told])


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


def checked_for_writing(points: NDArray[np.floating], columns: Columns) -> DecodedCloud:
    """`points` (n, 3) as little-endian float32, and its columns as they are. Raises BadField for other shapes."""
    if points.ndim != 2 or points.shape[1] != 3:
        raise BadField(f"points must be (n, 3), got {points.shape}", field="points")
    for name, values in columns.items():
        column(name).require_shape(values, len(points))
    return DecodedCloud(np.ascontiguousarray(points, dtype="<f4"), columns)


def records_for_writing(
    points: NDArray[np.floating], columns: Columns, *, packed_colours: bool = False
) -> NDArray[np.void]:
    """`points` (n, 3) and their columns as records (n,) of x, y, z and a field for each column, for a file.

    float32, but for coordinates that are given more exactly and lie from `FAR_M` on, as those of a map in UTM do:
    float64. A column has the type of its table, or float64 where times are no whole numbers; colours are red, green and
    blue, or one field as PCL has it: `packed_colours`.
    Raises BadField for other shapes.
    """
    cloud = checked_for_writing(points, columns)
    far = points.dtype == np.float64 and bool((np.abs(cloud.points) >= FAR_M).any())
    values = dict(zip("xyz", (points if far else cloud.points).T, strict=True))
    kinds = dict.fromkeys("xyz", "<f8" if far else "<f4")
    for name, told in _fields_of(columns, packed_colours).items():
        values[name], kinds[name] = told, told.dtype.newbyteorder("<").str
    records = np.empty(len(points), dtype=list(kinds.items()))
    for name, told in values.items():
        records[name] = told
    return records


def _fields_of(columns: Columns, packed_colours: bool) -> Columns:
    """The columns as fields of one value each."""
    fields = dict[str, NDArray[Any]]()
    for name, values in columns.items():
        if name == TIME.name and values.dtype.kind == "f":
            fields[name] = values.astype("<f8")
        elif name != RGB.name:
            fields[name] = values.astype(f"<{column(name).kind}")
        elif packed_colours:
            red, green, blue = values.astype("<u4").T
            fields[name] = (red << 16 | green << 8 | blue).astype("<u4").view("<f4")
        else:
            fields |= dict(zip(_APART[0], values.astype(np.uint8).T, strict=True))
    return fields


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
