"""PLY 1.0: ascii, binary_little_endian and binary_big_endian. Points come from the vertex element."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField, MalformedBody
from revisit.core.point_columns import NONE, USUAL, Columns
from revisit.formats import ascii_rows
from revisit.formats.cloud import (
    CloudLimits,
    Column,
    DecodedCloud,
    checked_for_writing,
    cloud_from_records,
    kinds_of,
    needed_fields,
    records_for_writing,
    require_exact_size,
    require_point_count,
)
from revisit.formats.text_header import field_name, natural, read_header

MAX_PROPERTIES = 256
MAX_ELEMENTS = 16

_CODES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_TYPES = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "uint16", "i4": "int"}
"""The types of what is written; Open3D reads 16 bits by this name alone."""
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class _Property:
    name: str
    code: str
    count_code: str | None = None


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)

    @property
    def has_list(self) -> bool:
        return any(item.count_code for item in self.properties)

    @property
    def stride(self) -> int:
        return sum(int(item.code[1]) for item in self.properties)


def decode(data: bytes, limits: CloudLimits, wanted: Collection[str] = USUAL) -> DecodedCloud:
    """The x, y, z properties of the vertices of a PLY file, and the columns that are `wanted` and there.

    The file must match its header exactly, faces and other elements included.
    Raises MalformedBody, BadField where a coordinate is missing, a list or no float, TooLarge.
    """
    elements, encoding, start = _read_header(data)
    vertices = next((element for element in elements if element.name == "vertex"), None)
    if vertices is None:
        raise MalformedBody("the PLY file has no vertex element")
    if vertices.has_list:
        raise BadField("a vertex may not have list properties", field="points")
    if encoding == "ascii":
        return _decode_ascii(elements, vertices, data[start:], limits, wanted)
    return _decode_binary(elements, vertices, memoryview(data)[start:], _ORDERS[encoding], limits, wanted)


def encode(points: NDArray[np.floating], columns: Columns = NONE) -> bytes:
    """A binary little-endian PLY file of points (n, 3) in metres and their columns; colours are red, green and blue.

    Floats, but for doubles where floats do not hold a millimetre (`records_for_writing`).
    """
    records = records_for_writing(points, columns)
    return _header(records, None) + records.tobytes()


def encode_mesh(vertices: NDArray[np.floating], normals: NDArray[np.floating], faces: NDArray[np.integer]) -> bytes:
    """A binary little-endian PLY mesh: vertices (v, 3) metres, unit normals (v, 3), faces (f, 3) of vertex indices.

    Raises BadField for other shapes or for an index outside of the vertices.
    """
    positions, directions = records_for_writing(vertices, {}), checked_for_writing(normals, {}).points
    if len(positions) != len(directions) or faces.ndim != 2 or faces.shape[1] != 3:
        raise BadField("a mesh needs as many normals as vertices, and faces (f, 3)", field="faces")
    if faces.size and not 0 <= int(faces.min()) <= int(faces.max()) < len(positions):
        raise BadField("a face names a vertex that does not exist", field="faces")
    triangles = np.empty(len(faces), dtype=[("corners", "u1"), ("vertices", "<i4", (3,))])
    triangles["corners"], triangles["vertices"] = 3, faces
    columns = [*kinds_of(positions).items(), *((name, "<f4") for name in ("nx", "ny", "nz"))]
    records = np.empty(len(positions), dtype=columns)
    for axis in "xyz":
        records[axis] = positions[axis]
    records["nx"], records["ny"], records["nz"] = directions.T
    return _header(records, len(faces)) + records.tobytes() + triangles.tobytes()


def _header(vertices: NDArray[np.void], face_count: int | None) -> bytes:
    """The declared vertices, which are records, and faces of a file."""
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property {_TYPES[kind[1:]]} {name}" for name, kind in kinds_of(vertices).items()]
    if face_count is not None:
        lines += [f"element face {face_count}", "property list uchar int vertex_indices"]
    return "\n".join([*lines, "end_header", ""]).encode("ascii")


def _read_header(data: bytes) -> tuple[list[_Element], str, int]:
    lines, start = read_header(data, "end_header")
    if lines[0] != ["ply"] or len(lines) < 3:
        raise MalformedBody("the body is not a PLY file")
    statements = [words for words in lines[1:-1] if words and words[0] not in {"comment", "obj_info"}]
    if not statements or len(statements[0]) != 3 or statements[0][0] != "format":
        raise MalformedBody("a PLY header must say its format first")
    _, encoding, version = statements[0]
    if encoding not in _ORDERS or version != "1.0":
        raise MalformedBody("the PLY format must be ascii, binary_little_endian or binary_big_endian, version 1.0")
    elements: list[_Element] = []
    for words in statements[1:]:
        _read_statement(words, elements)
    if lines[-1] != ["end_header"] or len({element.name for element in elements}) != len(elements):
        raise MalformedBody("a PLY header may name an element once")
    return elements, encoding, start


def _read_statement(words: list[str], elements: list[_Element]) -> None:
    """Add the element, or the property of the last element, that a header line declares."""
    match words:
        case ["element", name, count] if len(elements) < MAX_ELEMENTS:
            elements.append(_Element(field_name(name), natural(count, "the element count")))
        case ["property", "list", count_type, item_type, name] if elements:
            _add_property(elements[-1], _Property(field_name(name), _code(item_type), _code(count_type)))
        case ["property", item_type, name] if elements:
            _add_property(elements[-1], _Property(field_name(name), _code(item_type)))
        case _:
            raise MalformedBody(f"the PLY header may not hold {' '.join(words)[:60]!r} here")


def _add_property(element: _Element, item: _Property) -> None:
    if len(element.properties) >= MAX_PROPERTIES or item.name in {other.name for other in element.properties}:
        raise MalformedBody(f"element {element.name} has a property twice, or more than {MAX_PROPERTIES}")
    element.properties.append(item)


def _code(type_name: str) -> str:
    if type_name not in _CODES:
        raise MalformedBody(f"PLY has no type {type_name[:40]!r}")
    return _CODES[type_name]


def _columns(element: _Element, order: str) -> dict[str, Column]:
    columns, offset = {}, 0
    for item in element.properties:
        columns[item.name] = Column(item.name, order + item.code, offset)
        offset += int(item.code[1])
    return columns


def _decode_binary(
    elements: list[_Element],
    vertices: _Element,
    body: memoryview,
    order: str,
    limits: CloudLimits,
    wanted: Collection[str],
) -> DecodedCloud:
    start = 0
    vertex_start = 0
    for element in elements:
        if element is vertices:
            vertex_start = start
        start = _element_end(element, body, start, order)
    require_exact_size(start, len(body), vertices.count, limits)
    columns = _columns(vertices, order)
    content = body[vertex_start : vertex_start + vertices.count * vertices.stride]
    return cloud_from_records(content, vertices.count, vertices.stride, columns, wanted)


def _element_end(element: _Element, body: memoryview, start: int, order: str) -> int:
    """Where `element` ends; past the end of `body` is possible for fixed-size elements. Raises MalformedBody."""
    if not element.has_list:
        return start + element.count * element.stride
    if element.count > len(body) - start:
        raise MalformedBody(f"element {element.name} declares {element.count} rows in {len(body) - start} bytes")
    from revisit.formats import ply_lists  # numba takes 0.7 s to import, and clouds rarely have lists

    layout = [(int(item.count_code[1]) if item.count_code else 0, int(item.code[1])) for item in element.properties]
    if any(item.count_code and item.count_code[0] == "f" for item in element.properties):
        raise MalformedBody("the length of a PLY list must be an integer")
    return ply_lists.rows_end(body, start, element.count, layout, big_endian=order == ">")


def _decode_ascii(
    elements: list[_Element], vertices: _Element, body: bytes, limits: CloudLimits, wanted: Collection[str]
) -> DecodedCloud:
    declared = sum(element.count for element in elements)
    if declared != ascii_rows.count_rows(body):
        raise MalformedBody(f"the header declares {declared} rows, the body holds {ascii_rows.count_rows(body)}")
    require_point_count(vertices.count, limits)
    columns = _columns(vertices, "<")
    names, needed = list(columns), [column.name for column in needed_fields(columns, wanted)]
    places = [names.index(name) for name in needed]
    tables, row = [np.empty((0, len(places)))], 0
    for lines in ascii_rows.number_lines(body):
        for element, part in _by_element(elements, lines, row):
            if element is vertices:
                tables.append(part.table(len(names))[:, places])
            else:
                part.check_lists([item.count_code is not None for item in element.properties])
        row += len(lines)
    table = np.concatenate(tables)
    return DecodedCloud.from_fields(columns, wanted, lambda column: table[:, needed.index(column.name)])


def _by_element(
    elements: list[_Element], lines: ascii_rows.NumberLines, row: int
) -> Iterator[tuple[_Element, ascii_rows.NumberLines]]:
    """The parts of `lines`, the first of which is row `row` of the body, that belong to each element."""
    begin = 0
    for element in elements:
        first, last = max(begin - row, 0), min(begin + element.count - row, len(lines))
        if first < last:
            yield element, lines.between(first, last)
        begin += element.count
