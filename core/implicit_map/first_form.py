"""Reading neural maps stored until version 0.1: sections of bytes, and always with features (docs/decisions/0287)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import DataLoss
from revisit.core.geometry import octahedral
from revisit.core.implicit_map import blob
from revisit.core.implicit_map.neural_points import NeuralPoints
from revisit.core.implicit_map.settled import on_planes

FEATURE_STEP = 0.08
WEIGHT_POWER = 1.0
_NORMAL_STEPS = 63
_OFFSET_LEVELS = 63


def read_points(header: dict[str, Any], parts: list[bytes]) -> tuple[NeuralPoints, NDArray[np.float32]]:
    """Points and features (n, F) of the unpacked blob. Raises DataLoss."""
    try:
        count, resolution, width = int(header["count"]), float(header["resolution"]), int(header["features"])
        voxels = np.stack([np.cumsum(blob.from_varint(parts[axis], count)) for axis in range(3)], axis=1)
        normals = octahedral.decode(np.frombuffer(parts[3], np.uint8).reshape(2, count).T, _NORMAL_STEPS)
        levels = np.frombuffer(parts[4], np.uint8) * (2.0 / _OFFSET_LEVELS) - 1.0
        hits = np.frombuffer(parts[5], np.uint8).astype(np.int32)
        features = np.frombuffer(parts[6], np.int8).reshape(width, count).T * np.float32(FEATURE_STEP)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise DataLoss("the stored neural map cannot be read") from error
    heights = levels * (resolution * np.sqrt(3.0) / 2)
    geometry = on_planes(voxels.astype(np.int32), normals, heights, resolution)
    return NeuralPoints.remembered(*geometry, hits, len(header["stamps_ns"])), np.ascontiguousarray(features)
