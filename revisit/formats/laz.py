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
from revisit.formats.las import SCALE_M, Millimetres, levels

MEDIA_TYPE = "application/vnd.laszip"

_HEADER_BYTES, _POINT_BYTES = 227, 20
_COMPRESSED = 0x80
_GEO_KEYS = 34735
_MODEL_PROJECTED, _PROJECTED_CRS = (1024, 0, 1, 1), 3072
_EPSG = range(1024, 32767)


def encode(
    points: NDArray[np.floating], epsg: int | None = None, intensity: NDArray[np.floating] | None = None
) -> bytes:
    """A LAZ file of points (n, 3) in metres; `epsg` is the number of their projected reference system, 1024 to 32766.

    The `intensity` (n,) is written in 16 bits, as the format has it: 0 to 1, or 0 to 255, become 0 to 65535.

    Needs the package `lazrs`. Raises BadField as `Millimetres.of`, and for another number of a system.
    """
    import lazrs

    if epsg is not None and epsg not in _EPSG:
        raise BadField("the EPSG number of a projected system is 1024 to 32766", field="epsg")
    stored = Millimetres.of(points)
    packing = lazrs.LazVlr.new_for_compression(0, 0)
    records = [] if epsg is None else [_record("LASF_Projection", _GEO_KEYS, _geo_keys(epsg))]
    records.append(_record("laszip encoded", 22204, bytes(packing.record_data())))
    header = _header(stored, records)
    stream = io.BytesIO()
    stream.write(header + b"".join(records))
    compressor = lazrs.LasZipCompressor(stream, packing)
    compressor.compress_many(_rows(stored, intensity))
    compressor.done()
    return stream.getvalue()


def _rows(stored: Millimetres, intensity: NDArray[np.floating] | None) -> bytes:
    """The points as point records of format 0."""
    rows = np.zeros(
        len(stored.counts), dtype=[("xyz", "<i4", 3), ("intensity", "<u2"), ("rest", "u1", _POINT_BYTES - 14)]
    )
    rows["xyz"] = stored.counts
    if intensity is not None:
        rows["intensity"] = levels(intensity)
    rows["rest"][:, 0] = 0b00001001  # the first return of one
    return rows.tobytes()


def _header(stored: Millimetres, records: list[bytes]) -> bytes:
    """The public header block of LAS 1.2."""
    (low, high), count = stored.bounds(), len(stored.counts)
    start = _HEADER_BYTES + sum(map(len, records))
    return struct.pack(
        "<4sHH16sBB32s32sHHHIIBHI5I3d3d6d",
        b"LASF", 0, 0, bytes(16), 1, 2, b"OTHER", b"revisit", 0, 0, _HEADER_BYTES, start, len(records),
        _COMPRESSED, _POINT_BYTES, count, count, 0, 0, 0, 0, *[SCALE_M] * 3, *stored.offset,
        high[0], low[0], high[1], low[1], high[2], low[2],
    )  # fmt: skip


def _record(user: str, number: int, data: bytes) -> bytes:
    """A variable length record."""
    return struct.pack("<H16sHH32s", 0, user.encode(), number, len(data), b"") + data


def _geo_keys(epsg: int) -> bytes:
    """GeoTIFF keys: a projected system of this number, metres."""
    keys = (_MODEL_PROJECTED, (_PROJECTED_CRS, 0, 1, epsg))
    return struct.pack("<4H", 1, 1, 0, len(keys)) + b"".join(struct.pack("<4H", *key) for key in keys)
