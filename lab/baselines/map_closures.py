"""MapClosures (Gupta et al., ICRA 2024) from its own package, which is not installed with this product.

It learns every cloud it is asked about and compares it with all it has learned, so it is no `PlaceRecogniser`: clouds
must come in the order of the drive (`lab.recognition.sequential_baseline`). It was made for maps of 100 m, not for
submaps.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Iterable, Iterator

import numpy as np

from revisit.core.scan import Points

NAME = "map-closures"
PACKAGE = "map_closures"
VOXEL_M, MAX_RANGE_M = 0.5, 100.0
"""Of the package's own pipeline, version 2.2.0."""
MAP_M = 100.0
"""Length of a map in that pipeline, in metres travelled."""


def is_installed() -> bool:
    """Whether the package is there."""
    return importlib.util.find_spec(PACKAGE) is not None


def in_voxels(points: Points) -> Points:
    """The points (n, 3) that its voxel map keeps of a cloud, metres: it looks at densities, which near the path drown
    all else in raw clouds. Raises ModuleNotFoundError where the package is not installed."""
    kept = importlib.import_module(f"{PACKAGE}.voxel_map").VoxelMap(VOXEL_M, MAX_RANGE_M)
    kept.add_points(points)
    return np.asarray(kept.point_cloud(), dtype=np.float32)


def find_closures(clouds: Iterable[Points]) -> Iterator[dict[int, int]]:
    """For every cloud (n, 3) in turn, metres: which earlier clouds show the same place, by number.

    The value is the number of key points that agree on one alignment. As in the package's own pipeline, clouds pass
    through its voxel map. It never compares a cloud with the three before it, and seeds its RANSAC at random: the
    numbers vary from run to run. Raises ModuleNotFoundError where the package is not installed.
    """
    memory = importlib.import_module(f"{PACKAGE}.map_closures").MapClosures()
    for number, points in enumerate(clouds):
        closures = memory.get_closures(number, in_voxels(points))
        yield {int(closure.source_id): int(closure.number_of_inliers) for closure in closures}
