r"""Packed clouds, `application/vnd.revisit.pointcloud2`: sensor_msgs/PointCloud2 without a middleware.

    offset  type   meaning (little-endian)
    0       8s     magic "\x89RVPC2\r\n"
    8       u32    width
    12      u32    height
    16      u32    point_step: bytes a point, 1 to 65535
    20      u16    number of fields, 1 to 64
    22      u8     1 where the data is big-endian, else 0
    23      u8     encoding of the data: 0 raw, 1 quantised (`revisit.formats.quantised`)
    24             the fields, 40 bytes each:
                     32s name, ASCII, padded with NUL;  u32 offset;  u8 datatype;  u8 0;  u16 count
    24 + 40 f      raw: width x height x point_step bytes (row_step = width x point_step)
                   quantised: one quantised cloud of width x height points

Datatypes are those of sensor_msgs/PointField: 1 INT8, 2 UINT8, 3 INT16, 4 UINT16, 5 INT32, 6 UINT32, 7 FLOAT32,
8 FLOAT64. The gRPC message of that name carries the same `PackedCloud`, so a cloud has one meaning everywhere.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Collection
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import MalformedBody, UnsupportedEncoding
from revisit.core.point_columns import NONE, USUAL, Columns
from revisit.formats import quantised
from revisit.formats.cloud import (
    CloudLimits,
    Column,
    DecodedCloud,
    cloud_from_records,
    columns_from_fields,
    coordinates_from_records,
    field_of_records,
    kinds_of,
    records_for_writing,
    require_exact_size,
)

MAGIC = b"\x89RVPC2\r\n"
MAX_FIELDS = 64
MAX_POINT_STEP = 65_535

_HEADER = struct.Struct("<8sIIIHBB")
_FIELD = struct.Struct("<32sIBBH")
_NAME = re.compile(rb"([A-Za-z_][A-Za-z0-9_.\-]{0,31})\x00*")


class FieldType(IntEnum):
    """Datatypes of sensor_msgs/PointField."""

    INT8 = 1
    UINT8 = 2
    INT16 = 3
    UINT16 = 4
    INT32 = 5
    UINT32 = 6
    FLOAT32 = 7
    FLOAT64 = 8


class Encoding(IntEnum):
    """How the data of a packed cloud is written."""

    RAW = 0
    QUANTISED = 1


_CODES = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")


@dataclass(frozen=True)
class PointField:
    """One field of a point: `count` values of `datatype` (1..8, sensor_msgs/PointField) at byte `offset`."""

    name: str
    offset: int
    datatype: int
    count: int = 1

    @property
    def code(self) -> str:
        """The numpy type code without byte order, `f4`. Raises MalformedBody for an unknown datatype."""
        if not 1 <= self.datatype <= len(_CODES):
            raise MalformedBody(f"field {self.name} has the unknown datatype {self.datatype}")
        return _CODES[self.datatype - 1]

    @property
    def end(self) -> int:
        """The first byte after the field."""
        return self.offset + int(self.code[1]) * self.count


LIVOX_POINT = (
    PointField("offset_time", 0, FieldType.UINT32),
    *(PointField(name, 4 + 4 * index, FieldType.FLOAT32) for index, name in enumerate("xyz")),
    PointField("reflectivity", 16, FieldType.UINT8),
    PointField("line", 18, FieldType.UINT8),
)
"""Of a CustomMsg of Livox's drivers: nanoseconds since the first point, metres; at byte 17 there is a tag."""
LIVOX_POINT_BYTES = 19


@dataclass(frozen=True)
class PackedCloud:
    """A cloud as it travels: where the fields lie in each point, and the bytes of all points."""

    fields: tuple[PointField, ...]
    point_step: int
    width: int
    data: bytes
    height: int = 1
    big_endian: bool = False
    encoding: int = Encoding.RAW

    def to_bytes(self) -> bytes:
        """The body of media type `application/vnd.revisit.pointcloud2`."""
        header = _HEADER.pack(
            MAGIC, self.width, self.height, self.point_step, len(self.fields), self.big_endian, self.encoding
        )
        fields = [_FIELD.pack(f.name.encode("ascii"), f.offset, f.datatype, 0, f.count) for f in self.fields]
        return b"".join([header, *fields, self.data])

    @classmethod
    def from_bytes(cls, body: bytes) -> PackedCloud:
        """The packed cloud in such a body. Raises MalformedBody."""
        if len(body) < _HEADER.size or not body.startswith(MAGIC):
            raise MalformedBody("the body is not a packed cloud")
        _, width, height, point_step, field_count, big_endian, encoding = _HEADER.unpack_from(body)
        start = _HEADER.size + field_count * _FIELD.size
        if field_count > MAX_FIELDS or start > len(body) or big_endian > 1:
            raise MalformedBody("the header of the packed cloud is damaged")
        fields = tuple(_read_field(body, _HEADER.size + index * _FIELD.size) for index in range(field_count))
        return cls(fields, point_step, width, body[start:], height, bool(big_endian), encoding)


def decode_packed(packed: PackedCloud, limits: CloudLimits, wanted: Collection[str] = USUAL) -> DecodedCloud:
    """The x, y, z fields of a packed cloud, and the columns that are `wanted` and there; all of a quantised one.

    Raises MalformedBody, BadField where a coordinate is missing or no float, UnsupportedEncoding, TooLarge.
    """
    count = packed.width * packed.height
    if packed.encoding == Encoding.QUANTISED:
        cloud = quantised.decode(packed.data, limits)
        if len(cloud.points) != count:
            raise MalformedBody(f"the header declares {count} points, the data holds {len(cloud.points)}")
        return cloud
    if packed.encoding != Encoding.RAW:
        raise UnsupportedEncoding(f"encoding {packed.encoding} of a packed cloud is not known", field="encoding")
    return cloud_from_records(*_checked(packed, limits), wanted)


def decode_coordinates(packed: PackedCloud, limits: CloudLimits) -> NDArray[np.float64]:
    """The coordinates (n, 3) of a packed cloud, of full precision. Raises as `decode_packed` does."""
    if packed.encoding != Encoding.RAW:
        return decode_packed(packed, limits).points.astype(np.float64)
    return coordinates_from_records(*_checked(packed, limits))


def columns_of_points(packed: PackedCloud, wanted: Collection[str]) -> Columns:
    """The columns that are wanted and there, as the fields of a raw packed cloud have them.

    Fields that have several values, or do not lie within the points, are no columns; none is where points are not all
    there.
    """
    count = packed.width * packed.height
    if packed.encoding != Encoding.RAW or count * packed.point_step != len(packed.data):
        return {}
    fields, order = dict[str, Column](), ">" if packed.big_endian else "<"
    for one in packed.fields:
        known = 1 <= one.datatype <= len(_CODES) and one.count == 1
        if known and one.offset >= 0 and one.end <= packed.point_step:
            fields.setdefault(one.name, Column(one.name, order + one.code, one.offset))
    return columns_from_fields(fields, wanted, lambda one: field_of_records(packed.data, count, packed.point_step, one))


def _checked(packed: PackedCloud, limits: CloudLimits) -> tuple[memoryview, int, int, dict[str, Column]]:
    """The records of a raw packed cloud: their bytes, number, size and columns."""
    count, columns = packed.width * packed.height, _columns(packed)
    require_exact_size(count * packed.point_step, len(packed.data), count, limits)
    return memoryview(packed.data), count, packed.point_step, columns


def pack(points: NDArray[np.floating], columns: Columns = NONE, encoding: Encoding = Encoding.RAW) -> PackedCloud:
    """A packed cloud of points (n, 3) in metres and their columns, raw (coordinates are float32) or quantised."""
    records = records_for_writing(np.asarray(points, dtype=np.float32), columns)
    kinds = kinds_of(records)
    fields, offset = [], 0
    for name, kind in kinds.items():
        fields.append(PointField(name, offset, _CODES.index(kind[1:]) + 1))
        offset = fields[-1].end
    raw = encoding != Encoding.QUANTISED
    data = records.tobytes() if raw else quantised.encode(points, columns)
    return PackedCloud(tuple(fields), offset, len(records), data, encoding=encoding)


def decode(data: bytes, limits: CloudLimits, wanted: Collection[str] = USUAL) -> DecodedCloud:
    """The cloud in a body of this media type. Raises as `decode_packed` does."""
    return decode_packed(PackedCloud.from_bytes(data), limits, wanted)


def encode(points: NDArray[np.floating], columns: Columns = NONE) -> bytes:
    """A raw body of this media type."""
    return pack(points, columns).to_bytes()


def _read_field(body: bytes, start: int) -> PointField:
    name, offset, datatype, padding, count = _FIELD.unpack_from(body, start)
    match = _NAME.fullmatch(name)
    if match is None or padding:
        raise MalformedBody("a field of the packed cloud has an unusable name")
    return PointField(match[1].decode("ascii"), offset, datatype, count)


def _columns(packed: PackedCloud) -> dict[str, Column]:
    if not 0 < packed.point_step <= MAX_POINT_STEP or not 0 < len(packed.fields) <= MAX_FIELDS:
        raise MalformedBody("a packed cloud needs 1 to 64 fields and a point_step of 1 to 65535 bytes")
    if min(packed.width, packed.height) < 0:
        raise MalformedBody("width and height may not be negative")
    order = ">" if packed.big_endian else "<"
    columns: dict[str, Column] = {}
    for field in packed.fields:
        if field.name in columns or field.count < 1 or field.offset < 0 or field.end > packed.point_step:
            raise MalformedBody(f"field {field.name[:40]} appears twice or lies outside of the point")
        columns[field.name] = Column(field.name, order + field.code, field.offset)
    return columns
