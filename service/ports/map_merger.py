"""Evidence for and against the merge of two maps, as the workers ask for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry.se3 import Matrix4
from revisit.core.merge.evidence import JoiningLoops, MergeEvidence, MergeLimits
from revisit.service.ports.map_optimiser import MapGraph, OptimisedMap, Progress, TrackLoop

if TYPE_CHECKING:
    from revisit.core.merge.fused import PlacedMap

Surfaces: TypeAlias = "Callable[[int, Matrix4], PlacedMap]"
"""The neural map of a submap by number, placed at T_map_submap (4, 4). Raises DataLoss where there is none."""


@dataclass(frozen=True)
class DescribedPlaces:
    """The places of a map: descriptors (n, d), the number of each one's session (n,), its storey or None if unknown."""

    descriptors: NDArray[np.float32]
    sessions: NDArray[np.int64]
    storeys: tuple[str | None, ...]


@dataclass(frozen=True)
class AlignedMaps:
    """The poses of two maps in one graph, and the evidence of the loops between them."""

    optimised: OptimisedMap
    joining: JoiningLoops


@dataclass(frozen=True)
class PlacedSubmapMap:
    """A neural map by its blob, and where its submap lies: a `PlacedMap` of `core.merge` before it is read.

    Its `session` and `stamp_ns` where surfaces of several drives are told apart.
    """

    sha256: str
    T_map_submap: Matrix4
    session: int = 0
    stamp_ns: int = 0


class MapMerger(Protocol):
    """Finds out whether two maps are one."""

    @property
    def limits(self) -> MergeLimits:
        """The limits of evidence in a scene of the size of a street."""
        ...

    def candidates(self, first: DescribedPlaces, second: DescribedPlaces, k: int) -> list[tuple[int, int, float]]:
        """Rows of both that may show the same place, with the cosine of their descriptors, the likest first.

        A pair is there whichever of the maps is the first, unless its storeys are known and differ.
        """
        ...

    def align(
        self, graph: MapGraph, second: frozenset[int], spare: Sequence[TrackLoop], scale: float, progress: Progress
    ) -> AlignedMaps:
        """Optimise both maps together; `second` numbers the sessions of the one that joins.

        The poses do not rest on `spare` loops, which may still agree on another alignment.
        """
        ...

    def compare(
        self,
        first: Sequence[PlacedSubmapMap],
        second: Sequence[PlacedSubmapMap],
        read: Callable[[str], bytes],
        scale: float,
        progress: Progress,
    ) -> MergeEvidence:
        """Points of each against the field and the free space of the other. `read` gets a neural map by its hash."""
        ...

    def surfaces(self, read: Callable[[int], bytes]) -> Surfaces:
        """Surfaces for audits that ask for the same submaps again: the last ones stay decoded as long as it is held.

        `read` gets the neural map of a submap, and raises DataLoss where there is none.
        """
        ...

    def audit(
        self,
        first: Mapping[int, Matrix4],
        second: Mapping[int, Matrix4],
        surfaces: Surfaces,
        scale: float,
        most: int,
        progress: Progress,
    ) -> MergeEvidence | None:
        """The surfaces alone, by at most `most` pairs of submaps spread over the whole overlap; changes are not sought.

        T_map_submap (4, 4) of each group's submaps by number. Pairs with a lost neural map do not count. None where
        submaps lie near each other and no pair can be read.
        """
        ...
