"""What is asked of every method alike: which submaps may answer a query, and which answers are right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from revisit.evaluation.metrics import Flags, Floats, LoopProtocol, positive_pairs


@dataclass(frozen=True)
class Question:
    """(q, m) tables: `allowed` which submaps a query may be matched with, `positives` which of them show its place."""

    allowed: Flags
    positives: Flags

    @classmethod
    def within_session(cls, positions: Floats, protocol: LoopProtocol) -> Question:
        """Each submap of a drive asks the earlier ones beyond the index gap. positions (n, 3) metres."""
        index = np.arange(len(positions))
        allowed = index[:, None] - index[None] > protocol.min_index_gap
        return cls(allowed, positive_pairs(positions, protocol))

    @classmethod
    def between_sessions(cls, queries: Floats, known: Floats, radius_m: float) -> Question:
        """Each submap of one drive (q, 3) asks all of another (m, 3), in one world frame."""
        distance = np.linalg.norm(queries[:, None] - known[None], axis=2)
        return cls(np.ones(distance.shape, dtype=bool), distance <= radius_m)

    def only(self, answers: Flags) -> Question:
        """The same question where only the map submaps flagged in `answers` (m,) can be found."""
        return Question(self.allowed & answers[None], self.positives)
