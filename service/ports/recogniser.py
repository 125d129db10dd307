"""The method of `core`, as the workers call it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from revisit.core.codec.mesh import Mesh
from revisit.core.config import PipelineConfig, Profile
from revisit.core.pair_verdict import InitialPose, PairVerdict
from revisit.core.scan import Scan
from revisit.core.submap import Submap


@dataclass(frozen=True)
class SubmapDescription:
    """A worker's description of a submap: `descriptor` (d,) float32, L2-normalised, and blobs, versioned by `core`.

    `neural_map` is None where there is none, or where the stored one was described again.
    """

    descriptor: NDArray[np.float32]
    place: bytes
    neural_map: bytes | None = None
    flags: tuple[str, ...] = ()
    timings_s: dict[str, float] = field(default_factory=dict)


class PlaceKeeper(Protocol):
    """A cache of decoded places, as long as there is room."""

    def release(self) -> None:
        """Empty the cache of decoded places: a job that needs much memory follows."""
        ...


class PlaceRecogniser(PlaceKeeper, Protocol):
    """The method, as the workers call it."""

    def model_of(self, profile: Profile) -> str:
        """The version of the models of a profile. Descriptors of different versions must not be compared."""
        ...

    def inspect(self, scans: Sequence[Scan]) -> tuple[str, ...]:
        """Codes of likely mistakes in the scans of a submap (`revisit.core.sanity`)."""
        ...

    def describe(self, submap: Submap, config: PipelineConfig) -> SubmapDescription:
        """Neural map, descriptor and place of a submap.

        Raises RevisitError where it cannot be described, MissingLibrary where what its profile takes is not installed.
        """
        ...

    def describe_again(self, neural_map: bytes, place: bytes | None, config: PipelineConfig) -> SubmapDescription:
        """This version's description of a submap from its stored neural map. Raises RevisitError where it cannot be
        made.

        Values that need the scans are taken over from the former `place`, if it is there and readable.
        """
        ...

    def mesh(self, neural_map: bytes, config: PipelineConfig) -> Mesh:
        """The surface of a submap from its stored neural map. Raises DataLoss, DescriptorModelMismatch."""
        ...

    def verify(
        self, query: bytes, match: bytes, similarity: float, config: PipelineConfig, initial: InitialPose | None = None
    ) -> PairVerdict:
        """`revisit.core.verification.verify` of two stored places. Raises DataLoss for damaged ones."""
        ...
