"""A method whose verdicts are remembered."""

from __future__ import annotations

from dataclasses import dataclass, field

from revisit.core.config import PipelineConfig
from revisit.core.submap import Submap
from revisit.core.verification import InitialPose, PairVerdict
from revisit.evaluation.drive_acceptance import PairMethod, judging
from revisit.evaluation.loop_closure_method import Description, LoopClosureMethod, Verdict, verdict_of_pair


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


@dataclass(frozen=True)
class RememberedPairs(RememberedVerdicts):
    """The same for a method whose pairs can be judged together."""

    pairs: dict[tuple[bytes, bytes], PairVerdict] = field(default_factory=dict, repr=False)

    @property
    def config(self) -> PipelineConfig:
        """Of the method."""
        return self._product.config

    def verify(self, query: bytes, match: bytes, similarity: float) -> Verdict:
        """The verdict on the pair alone."""
        return verdict_of_pair(self.verify_pair(query, match, similarity))

    def verify_pair(
        self, query: bytes, match: bytes, similarity: float, initial: InitialPose | None = None
    ) -> PairVerdict:
        """As the method does; a pair without an initial pose is verified once."""
        if initial is not None:
            return self._product.verify_pair(query, match, similarity, initial)
        if (query, match) not in self.pairs:
            self.pairs[query, match] = self._product.verify_pair(query, match, similarity)
        return self.pairs[query, match]

    @property
    def _product(self) -> PairMethod:
        product = judging(self.method)
        if product is None:
            raise TypeError(f"{self.method!r} judges each pair alone")
        return product


def remembered(method: LoopClosureMethod) -> RememberedVerdicts:
    """A method with its verdicts remembered, once."""
    if isinstance(method, RememberedVerdicts):
        return method
    return RememberedVerdicts(method) if judging(method) is None else RememberedPairs(method)
