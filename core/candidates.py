"""Candidate policy: which earlier submaps are verified as loop closures of a new one, and how many (paper IV-B)."""

from __future__ import annotations

from dataclasses import dataclass

from revisit.core.config import LoopConfig


@dataclass(frozen=True)
class CandidatePolicy:
    """Who may be a candidate of the submap number `ordinal` of `session`.

    Submaps of other sessions, and those of its own session that are at least `min_gap` submaps away; of these the
    `count` most similar ones.
    """

    session: int
    ordinal: int
    min_gap: int
    count: int

    def allows(self, session: int, ordinal: int) -> bool:
        """Whether submap number `ordinal` of `session` may be a candidate."""
        return session != self.session or abs(ordinal - self.ordinal) >= self.min_gap


def candidate_policy(session: int, ordinal: int, config: LoopConfig) -> CandidatePolicy:
    """The policy for submap number `ordinal` of `session`."""
    return CandidatePolicy(session, ordinal, config.min_index_gap, config.candidates)
