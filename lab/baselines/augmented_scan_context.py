"""Scan Context++ (Kim, Choi and Kim, T-RO 2022): the polar context, also as seen from a lane to the side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.scan import Points
from revisit.evaluation.baselines.place_recogniser import Descriptor
from revisit.evaluation.baselines.scan_context import ScanContext


@dataclass(frozen=True)
class AugmentedScanContext:
    """The augmented polar context: a query stands in for its neighbours `aside_m` away (paper: 2 m).

    The paper moves the root along the lateral axis of the vehicle. A turned submap does not tell that axis, so the root
    is moved along both horizontal axes, which includes a lane change in any direction within 45 degrees. The Cart
    context is left out: it needs the vehicle's heading.
    """

    context: ScanContext = ScanContext()
    aside_m: float = 2.0

    @property
    def name(self) -> str:
        """The name of the method in reports."""
        return "scan-context++"

    def describe(self, points: Points) -> Descriptor:
        """Contexts (5, rings, sectors): from the origin, and from `aside_m` before, behind, left and right of it."""
        roots = self.aside_m * np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]], dtype=points.dtype)
        return np.stack([self.context.describe(points - root) for root in roots])

    def similarities(self, query: Descriptor, places: NDArray[np.float32]) -> NDArray[np.float64]:
        """The best similarity of any context of the query to the context of each place from its origin."""
        origins = places[:, 0]
        return np.asarray(np.max([self.context.similarities(one, origins) for one in query], axis=0))
