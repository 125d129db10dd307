"""A method whose verdicts are remembered."""

from __future__ import annotations

from dataclasses import dataclass, field

from revisit.core.submap import Submap
from revisit.evaluation.loop_closure_method import Description, LoopClosureMethod, Verdict


@dataclass(frozen=True)
class RememberedVerdicts:
    """A method that verifies each pair of places once: several searches may propose the same pair."""

    method: LoopClosureMethod
    known: dict[tuple[bytes, bytes], Verdict] = field(default_factory=dict, repr=False)

    def describe(self, submap: Submap, seed: int) -> Description:
        """As the method does."""
        return self.method.describe(submap, seed)

    def verify(self, query: bytes, match: bytes, similarity: float) -> Verdict:
        """As the method does the first time; its verdict must not depend on the similarity."""
        if (query, match) not in self.known:
            self.known[query, match] = self.method.verify(query, match, similarity)
        return self.known[query, match]
