"""Clouds as LAZ 1.2 (compressed LAS), which surveying and GIS tools read; written only.

Coordinates are kept to a millimetre. A map of one's own has no coordinate reference system; where its frame is that of
a survey, the EPSG number says so.
"""

from __future__ import annotations

import io
import struct

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.core.point_columns import NONE, RGB, RING, TIME, Columns
from revisit.formats.las import EXTRA_BYTES, SCALE_M, Millimetres, extra_dimension, fill

MEDIA_TYPE = "application/vnd.laszip"

_HEADER_BYTES = 227
_COMPRESSED = 0x80
_FIRST_OF_ONE = 0b00001001
_GEO_KEYS = 34735
_MODEL_PROJECTED, _PROJECTED_CRS = (1024, 0, 1, 1), 3072
_EPSG = range(1024, 32767)


def encode(points: NDArray[np.floating], epsg: int | None = None, columns: Columns = NONE) -> bytes:
    """A LAZ file of points (n, 3) in metres; `epsg` is the number of their projected reference system, 1024 to 32766.

    Intensity and colours are written in 16 bits, as the format has them: an intensity of 0 to 1, or 0 to 255, becomes 0
    to 65535. A time, seconds since 1970, is GPS time; the ring is a dimension of its own.

    Needs the package `lazrs`. Raises BadField as `Millimetres.of`, and for another number of a system.
    """
    import lazrs

    if epsg is not None and epsg not in _EPSG:
        raise BadField("the EPSG number of a projected system is 1024 to 32766", field="epsg")
    stored = Millimetres.of(points)
    rows, ringed = _rows(stored, columns), RING.name in columns
    point_format = (TIME.name in columns) + 2 * (RGB.name in columns)
    packing = lazrs.LazVlr.new_for_compression(point_format, 2 * ringed)
    records = [] if epsg is None else [_record("LASF_Projection", _GEO_KEYS, _geo_keys(epsg))]
    records += [_record(*EXTRA_BYTES, extra_dimension("<u2"))] if ringed else []
    records.append(_record("laszip encoded", 22204, bytes(packing.record_data())))
    stream = io.BytesIO()
    stream.write(_header(stored, records, point_format, rows.itemsize) + b"".join(records))
    compressor = lazrs.LasZipCompressor(stream, packing)
    compressor.compress_many(rows.tobytes())
    compressor.done()
    return stream.getvalue()


def _rows(stored: Millimetres, columns: Columns) -> NDArray[np.void]:
    """The points as point records of format 0; 1 with times, 2 with colours, 3 with both; the ring behind it."""
    further = {TIME.name: ("<f8", ()), RGB.name: ("<u2", (3,)), RING.name: ("<u2", ())}
    fields = [(name, *further[name]) for name in further if name in columns]
    record = [("xyz", "<i4", (3,)), ("intensity", "<u2", ()), ("returns", "u1", ()), ("rest", "u1", (5,)), *fields]
    rows = np.zeros(len(stored.counts), dtype=record)
    rows["xyz"], rows["returns"] = stored.counts, _FIRST_OF_ONE
    fill(rows, columns)
    return rows


def _header(stored: Millimetres, records: list[bytes], point_format: int, point_bytes: int) -> bytes:
    """The public header block of LAS 1.2; times, where there are such, are adjusted standard GPS times."""
    (low, high), count = stored.bounds(), len(stored.counts)
    start = _HEADER_BYTES + sum(map(len, records))
    return struct.pack(
        "<4sHH16sBB32s32sHHHIIBHI5I3d3d6d",
        b"LASF", 0, point_format & 1, bytes(16), 1, 2, b"OTHER", b"revisit", 0, 0, _HEADER_BYTES, start, len(records),
        _COMPRESSED | point_format, point_bytes, count, count, 0, 0, 0, 0, *[SCALE_M] * 3, *stored.offset,
        high[0], low[0], high[1], low[1], high[2], low[2],
    )  # fmt: skip


def _record(user: str, number: int, data: bytes) -> bytes:
    """A variable length record."""
    return struct.pack("<H16sHH32s", 0, user.encode(), number, len(data), b"") + data


def _geo_keys(epsg: int) -> bytes:
    """GeoTIFF keys: a projected system of this number, metres."""
    keys = (_MODEL_PROJECTED, (_PROJECTED_CRS, 0, 1, epsg))
    return struct.pack("<4H", 1, 1, 0, len(keys)) + b"".join(struct.pack("<4H", *key) for key in keys)
