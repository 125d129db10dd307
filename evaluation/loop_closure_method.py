"""A loop closure method under evaluation: it describes submaps and verifies candidates. The product is one."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.submap import Submap
from revisit.core.verification import InitialPose, PairVerdict, RejectedLoop


@dataclass(frozen=True)
class Description:
    """The stored form of a submap.

    vector (d,) float32 of length 1; `place` the bytes that verification needs; neural_map_bytes 0 where there is none;
    seconds by stage.
    """

    vector: NDArray[np.float32]
    place: bytes
    neural_map_bytes: int = 0
    seconds: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Verdict:
    """The verdict on a candidate.

    score in [0, 1]; reason of a rejection, None where accepted; T_match_query where it was estimated; doubts, by name,
    that the claims beside it raised.
    """

    score: float
    reason: str | None
    T_match_query: se3.Matrix4 | None
    evidence: dict[str, float] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()

    @property
    def accepted(self) -> bool:
        """Whether the candidate passed every gate."""
        return self.reason is None


class LoopClosureMethod(Protocol):
    """Describes submaps and verifies candidates. It must be picklable: it is sent to worker processes."""

    def describe(self, submap: Submap, seed: int) -> Description:
        """The stored form of a submap."""

    def verify(self, query: bytes, match: bytes, similarity: float) -> Verdict:
        """Whether the places of two submaps are the same, and how they align."""


@dataclass(frozen=True)
class RevisitMethod:
    """The product: core.pipeline with the shipped models of a profile, `config` being the product's parameters.

    ablation: none, no-implicit, bev-only or normals-only; profile: product or paper.
    """

    config: PipelineConfig = field(default_factory=PipelineConfig)
    ablation: str = "none"
    profile: str = "product"

    def describe(self, submap: Submap, seed: int) -> Description:
        """The fused descriptor, the place and the size of the neural map. Raises core.errors.RevisitError."""
        from revisit.core.pipeline import DescribedPlace
        from revisit.core.profiles import Profile, profile_config, profile_models
        from revisit.core.stages import stage_times
        from revisit.evaluation.ablation import Ablation, describe_ablated

        profile, ablation = Profile(self.profile), Ablation(self.ablation)
        config = profile_config(profile, self.config)
        with stage_times() as seconds:
            described = describe_ablated(submap, profile_models(profile), config, seed, ablation)
        neural_map_bytes = len(described.neural_map.to_blob()) if isinstance(described, DescribedPlace) else 0
        vector, place = described.descriptor.vector, described.place.to_blob()
        return Description(vector, place, neural_map_bytes, seconds)

    def verify(self, query: bytes, match: bytes, similarity: float) -> Verdict:
        """The verdict on the pair by itself. Raises DataLoss for damaged places."""
        return verdict_of_pair(self.verify_pair(query, match, similarity))

    def verify_pair(
        self, query: bytes, match: bytes, similarity: float, initial: InitialPose | None = None
    ) -> PairVerdict:
        """`revisit.core.verification.verify` of two stored places."""
        from revisit.core.pipeline import verify
        from revisit.core.place import Place

        pair = Place.from_blob(query), Place.from_blob(match)
        return verify(*pair, similarity, self.config.verification, initial)


def verdict_of_pair(loop: PairVerdict) -> Verdict:
    """The verdict on a pair by itself as a method gives it."""
    reason = str(loop.reason) if isinstance(loop, RejectedLoop) else None
    measured = loop.measurement
    if measured is None:
        return Verdict(0.0, reason, None)
    names = ("inliers", "inlier_ratio", "overlap", "contrast", "seen_through", "rmse_m")
    evidence = {name: float(getattr(measured, name)) for name in names}
    return Verdict(float(measured.score), reason, measured.T_match_query, evidence)
