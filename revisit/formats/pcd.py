"""PCD (Point Cloud Library): `DATA ascii`, `binary` and `binary_compressed`."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import MalformedBody, TooLarge
from revisit.core.point_columns import NONE, USUAL, Columns
from revisit.formats import ascii_rows
from revisit.formats.cloud import (
    CloudLimits,
    Column,
    DecodedCloud,
    cloud_from_records,
    coordinates_of,
    kinds_of,
    needed_fields,
    records_for_writing,
    require_exact_size,
    require_point_count,
)
from revisit.formats.text_header import field_name, natural, read_header

MAX_FIELDS = 256
MAX_STRIDE_BYTES = 65_536
PADDING = "_"

_KEYWORDS = {"VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA"}
_REQUIRED = _KEYWORDS - {"VERSION", "COUNT", "VIEWPOINT"}
_SIZES = {"F": {4, 8}, "I": {1, 2, 4, 8}, "U": {1, 2, 4, 8}}


@dataclass(frozen=True)
class _Field:
    name: str
    kind: str
    size: int
    count: int

    @property
    def dtype(self) -> str:
        return f"<{self.kind.lower()}{self.size}"


@dataclass(frozen=True)
class _Header:
    fields: tuple[_Field, ...]
    points: int
    encoding: str

    @property
    def stride(self) -> int:
        return sum(field.size * field.count for field in self.fields)


def decode(data: bytes, limits: CloudLimits, wanted: Collection[str] = USUAL) -> DecodedCloud:
    """The x, y, z fields of a PCD file, and the columns that are `wanted` and there.

    The file must match its header exactly. Raises MalformedBody, BadField, TooLarge.
    """
    header, start = _read_header(data)
    if header.encoding == "ascii":
        return _decode_ascii(header, data[start:], limits, wanted)
    body = memoryview(data)[start:]
    if header.encoding == "binary":
        require_exact_size(header.points * header.stride, len(body), header.points, limits)
        return cloud_from_records(body, header.points, header.stride, _interleaved(header), wanted)
    return _decode_compressed(header, body, limits, wanted)


def encode(points: NDArray[np.floating], columns: Columns = NONE) -> bytes:
    """A binary PCD file of points (n, 3) in metres and their columns; colours are one field, as PCL has them.

    Floats, but for doubles where floats do not hold a millimetre (`records_for_writing`).
    """
    records = records_for_writing(points, columns, packed_colours=True)
    kinds = kinds_of(records)
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        f"FIELDS {' '.join(kinds)}",
        f"SIZE {' '.join(kind[2:] for kind in kinds.values())}",
        f"TYPE {' '.join(kind[1].upper() for kind in kinds.values())}",
        f"COUNT {' '.join(['1'] * len(kinds))}",
        f"WIDTH {len(records)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(records)}",
        "DATA binary",
        "",
    ]
    return "\n".join(header).encode("ascii") + records.tobytes()


def _read_header(data: bytes) -> tuple[_Header, int]:
    lines, start = read_header(data, "DATA")
    entries: dict[str, list[str]] = {}
    for words in lines:
        if not words or words[0].startswith("#"):
            continue
        if words[0] not in _KEYWORDS or words[0] in entries:
            raise MalformedBody(f"a PCD header may not hold {words[0][:40]!r} here")
        entries[words[0]] = words[1:]
    if missing := _REQUIRED - entries.keys():
        raise MalformedBody(f"the PCD header lacks {', '.join(sorted(missing))}")
    encoding = entries["DATA"]
    if len(encoding) != 1 or encoding[0] not in {"ascii", "binary", "binary_compressed"}:
        raise MalformedBody("DATA must be ascii, binary or binary_compressed")
    return _Header(_read_fields(entries), _read_count(entries), encoding[0]), start


def _read_count(entries: dict[str, list[str]]) -> int:
    values = []
    for keyword in ("WIDTH", "HEIGHT", "POINTS"):
        if len(entries[keyword]) != 1:
            raise MalformedBody(f"{keyword} must be one number")
        values.append(natural(entries[keyword][0], keyword))
    width, height, points = values
    if width * height != points:
        raise MalformedBody(f"WIDTH x HEIGHT is {width * height}, POINTS is {points}")
    return points


def _read_fields(entries: dict[str, list[str]]) -> tuple[_Field, ...]:
    names, kinds = entries["FIELDS"], entries["TYPE"]
    sizes, counts = entries["SIZE"], entries.get("COUNT", ["1"] * len(names))
    if not 0 < len(names) <= MAX_FIELDS or not len(names) == len(kinds) == len(sizes) == len(counts):
        raise MalformedBody(f"FIELDS, SIZE, TYPE and COUNT must have the same length, 1 to {MAX_FIELDS}")
    fields = tuple(
        _Field(field_name(name), kind, natural(size, "SIZE"), natural(count, "COUNT"))
        for name, kind, size, count in zip(names, kinds, sizes, counts, strict=True)
    )
    for field in fields:
        if field.size not in _SIZES.get(field.kind, set()) or not 0 < field.count <= MAX_STRIDE_BYTES:
            raise MalformedBody(f"field {field.name} has an impossible TYPE, SIZE or COUNT")
    named = [field.name for field in fields if field.name != PADDING]
    if len(named) != len(set(named)):
        raise MalformedBody("FIELDS names a field twice")
    if sum(field.size * field.count for field in fields) > MAX_STRIDE_BYTES:
        raise MalformedBody(f"a point may have {MAX_STRIDE_BYTES} bytes")
    return fields


def _interleaved(header: _Header) -> dict[str, Column]:
    """The scalar columns with their offsets within one point."""
    columns, offset = {}, 0
    for field in header.fields:
        if field.count == 1:
            columns[field.name] = Column(field.name, field.dtype, offset)
        offset += field.size * field.count
    return columns


def _decode_ascii(header: _Header, body: bytes, limits: CloudLimits, wanted: Collection[str]) -> DecodedCloud:
    per_row = sum(field.count for field in header.fields)
    if header.points * per_row * 2 > len(body) + 1:
        raise MalformedBody(f"{len(body)} bytes cannot hold {header.points} rows of {per_row} numbers")
    require_point_count(header.points, limits)
    positions, position = {}, 0
    for field in header.fields:
        positions[field.name] = position
        position += field.count
    columns = _interleaved(header)
    needed = [column.name for column in needed_fields(columns, wanted)]
    table = ascii_rows.parse_rows(body, header.points, per_row, [positions[name] for name in needed])
    return DecodedCloud.from_fields(columns, wanted, lambda column: table[:, needed.index(column.name)])


def _decode_compressed(header: _Header, body: memoryview, limits: CloudLimits, wanted: Collection[str]) -> DecodedCloud:
    """`binary_compressed`: two uint32 sizes, then LZF of the fields one after another."""
    from revisit.formats import lzf  # numba takes 0.7 s to import, and few files need it

    if len(body) < 8:
        raise MalformedBody("the compressed body lacks its sizes")
    packed, unpacked = (int(size) for size in np.frombuffer(body[:8], dtype="<u4"))
    if unpacked != header.points * header.stride or packed != len(body) - 8:
        raise MalformedBody("the compressed sizes disagree with the header or with the body")
    require_point_count(header.points, limits)
    if unpacked > limits.max_decoded_bytes:
        raise TooLarge(f"a body may decode to {limits.max_decoded_bytes} bytes, this one declares {unpacked}")
    columns = _interleaved(header)
    coordinates_of(columns)
    content = lzf.decompress(body[8:], unpacked)
    starts, start = {}, 0
    for field in header.fields:
        starts[field.name] = start
        start += field.size * field.count * header.points

    def read(column: Column) -> NDArray[np.generic]:
        return np.frombuffer(content, dtype=column.dtype, count=header.points, offset=starts[column.name])

    return DecodedCloud.from_fields(columns, wanted, read)
