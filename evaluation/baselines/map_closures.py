"""MapClosures (Gupta et al., ICRA 2024) from its own package, which is not installed with this product.

It learns every cloud it is asked about and compares it with all it has learned, so it is no `PlaceRecogniser`: clouds
must come in the order of the drive (`evaluation.protocols.in_order`). It was made for maps of 100 m, not for submaps.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Iterable, Iterator

import numpy as np

from core.scan import Points

NAME = "map-closures"
PACKAGE = "map_closures"
MEASURED_VERSION = "2.2.0"


def is_installed() -> bool:
    """Whether the package is there."""
    return importlib.util.find_spec(PACKAGE) is not None


def find_closures(clouds: Iterable[Points]) -> Iterator[dict[int, int]]:
    """For every cloud (n, 3) in turn, metres: which earlier clouds show the same place, by number.

    The value is the number of key points that agree on one alignment. The package never compares a cloud with the three
    before it, and seeds its RANSAC at random: the numbers vary from run to run. Raises ModuleNotFoundError where it is
    not installed.
    """
    memory = importlib.import_module(f"{PACKAGE}.map_closures").MapClosures()
    for number, points in enumerate(clouds):
        closures = memory.get_closures(number, points.astype(np.float64))
        yield {int(closure.source_id): int(closure.number_of_inliers) for closure in closures}
