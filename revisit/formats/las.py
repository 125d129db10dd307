"""What files of LAS have in common: coordinates as whole millimetres, intensity in 16 bits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField

SCALE_M = 0.001

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
