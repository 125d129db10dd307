"""KITTI Velodyne scans: float32 little-endian (x, y, z, intensity), 16 bytes a point, no header."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import MalformedBody
from revisit.core.point_columns import INTENSITY, NONE, Columns, only
from revisit.formats.cloud import CloudLimits, DecodedCloud, checked_for_writing, require_point_count

POINT_BYTES = 16


def decode(data: bytes, limits: CloudLimits) -> DecodedCloud:
    """The points and intensities of a KITTI scan. Raises MalformedBody, TooLarge."""
    if len(data) % POINT_BYTES:
        raise MalformedBody(f"a KITTI scan has {POINT_BYTES} bytes a point; {len(data)} is not a multiple")
    require_point_count(len(data) // POINT_BYTES, limits)
    records = np.frombuffer(data, dtype="<f4").reshape(-1, 4)
    return DecodedCloud.of_table(records)


def encode(points: NDArray[np.floating], columns: Columns = NONE) -> bytes:
    """A KITTI scan of points (n, 3) in metres, and of their columns the intensity, 0 where it is not given."""
    cloud = checked_for_writing(points, only(columns, (INTENSITY.name,)))
    reflected = cloud.columns.get(INTENSITY.name, np.zeros(len(cloud.points)))
    return np.column_stack([cloud.points, reflected]).astype("<f4").tobytes()
