"""What files of LAS have in common: coordinates as whole millimetres, intensity and colours in 16 bits, GPS time."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField
from revisit.core.point_columns import INTENSITY, RGB, RING, TIME, Columns

SCALE_M = 0.001

EXTRA_BYTES = ("LASF_Spec", 4)
"""Who defines the record that names further dimensions of a point, and its number."""

_EXTRA_TYPES = {"<u1": 1, "<u2": 3}

_UNIX_AT_GPS_0 = 315_964_800
_GPS_OFFSET_S = 1_000_000_000
"""Adjusted standard GPS time is GPS time less this."""

_LEAPS = (
    (0, 13),
    (1_136_073_600, 14),
    (1_230_768_000, 15),
    (1_341_100_800, 16),
    (1_435_708_800, 17),
    (1_483_228_800, 18),
)
"""From a Unix time on, GPS is ahead of UTC by so many seconds; 13 up to 2006 (IERS Bulletin C)."""

_INT32, _UINT16 = np.iinfo(np.int32), np.iinfo(np.uint16)


@dataclass(frozen=True)
class Millimetres:
    """Points as `counts` (n, 3), whole millimetres from `offset` (3,), metres."""

    counts: NDArray[np.int32]
    offset: NDArray[np.float64]

    @classmethod
    def of(cls, points: NDArray[np.floating]) -> Millimetres:
        """Points (n, 3) in metres.

        Raises BadField for other shapes, for numbers that are not finite and for a cloud wider than 4,000 km.
        """
        if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not np.isfinite(points).all():
            raise BadField("points must be (n, 3), finite, and at least one", field="points")
        offset = np.floor(points.astype(np.float64).mean(axis=0))
        counts = np.round((points.astype(np.float64) - offset) / SCALE_M)
        if np.abs(counts).max() > _INT32.max:
            raise BadField("a file of LAS holds at most 4,000 km across", field="points")
        return cls(counts.astype(np.int32), offset)

    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The least and the largest coordinates, metres."""
        return self._metres(self.counts.min(axis=0)), self._metres(self.counts.max(axis=0))

    def _metres(self, counts: NDArray[np.int32]) -> NDArray[np.float64]:
        return counts * SCALE_M + self.offset


def levels(intensity: NDArray[np.floating]) -> NDArray[np.uint16]:
    """An intensity in steps of 16 bits: LAS has it as a share of the sensor's range, 1, 255 or 65535."""
    largest = float(intensity.max(initial=0.0))
    span = next((one for one in (1.0, 255.0) if largest <= one), float(_UINT16.max))
    scaled = np.rint(intensity.astype(np.float64) * (_UINT16.max / span))
    return np.clip(scaled, 0, _UINT16.max).astype(np.uint16)


def gps_seconds(unix_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unix times as adjusted standard GPS times, seconds: those that LAS has since 1.2."""
    since, ahead = (np.array(column, dtype=np.float64) for column in zip(*_LEAPS, strict=True))
    row = np.maximum(np.searchsorted(since, unix_s, side="right") - 1, 0)
    return unix_s - (_UNIX_AT_GPS_0 + _GPS_OFFSET_S) + ahead[row]


def fill(rows: NDArray[np.void], columns: Columns) -> None:
    """Put the columns into point records with fields of such names; times are seconds since 1970."""
    for name, values in columns.items():
        if name == INTENSITY.name:
            rows[name] = levels(values)
        elif name == TIME.name:
            rows[name] = gps_seconds(values)
        elif name == RGB.name:
            rows[name] = values.astype(np.uint16) * 257
        else:
            rows[name] = values


def extra_dimension(kind: str) -> bytes:
    """The description of the ring as a dimension of its own, of numpy type `kind`."""
    name, told = RING.name.encode(), RING.unit.encode()
    return struct.pack("<HBB32s124x32s", 0, _EXTRA_TYPES[kind], 0, name, told[:32])
