"""Ground truth of an experiment: which map submaps a query may be matched with, and which of them show its place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from revisit.core.acceptance.revisits import are_revisits
from revisit.core.config import LoopConfig
from revisit.evaluation.metrics import Flags, Floats, LoopProtocol, positive_pairs


@dataclass(frozen=True)
class GroundTruth:
    """Tables of queries by map submaps, (q, m): `allowed` matches of a query, and its true `positives`."""

    allowed: Flags
    positives: Flags

    @classmethod
    def within_session(cls, positions: Floats, protocol: LoopProtocol) -> GroundTruth:
        """Each submap of a drive is matched with the earlier ones beyond the index gap. positions (n, 3) metres."""
        index = np.arange(len(positions))
        allowed = index[:, None] - index[None] > protocol.min_index_gap
        return cls(allowed, positive_pairs(positions, protocol))

    @classmethod
    def of_one_drive(cls, positions: Floats, config: LoopConfig, radius_m: float) -> GroundTruth:
        """Each submap of a drive is matched as in the product: with the earlier ones that may be loops (decision 0316).

        Of those passed aside (decision 0353) the ones beyond `radius_m` are left out: they share a view, and are no
        wrong match. positions (n, 3) metres.
        """
        count = len(positions)
        near = np.linalg.norm(positions[:, None] - positions[None], axis=2) <= radius_m
        rows = [are_revisits(positions, row, config) & near[row] for row in range(count)]
        entered = [are_revisits(positions, row, config, aside=1.0) for row in range(count)]
        allowed = np.tril((np.array(rows, dtype=bool) | np.array(entered, dtype=bool)).reshape(count, count))
        return cls(allowed, allowed & near)

    @classmethod
    def between_sessions(cls, queries: Floats, known: Floats, radius_m: float) -> GroundTruth:
        """Each submap of one drive (q, 3) is matched with all of another (m, 3), in one world frame, metres."""
        distance = np.linalg.norm(queries[:, None] - known[None], axis=2)
        return cls(np.ones(distance.shape, dtype=bool), distance <= radius_m)

    def restricted_to(self, found: Flags) -> GroundTruth:
        """The same where only the map submaps flagged in `found` (m,) may be matched."""
        return GroundTruth(self.allowed & found[None], self.positives)
