"""The method of `core`, as the workers call it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import PipelineConfig
from revisit.core.geometry.se3 import Matrix4
from revisit.core.submap import Submap


@dataclass(frozen=True)
class Mesh:
    """Triangles: vertices (v, 3) float32 metres in the submap frame, unit normals (v, 3), faces (f, 3) int32."""

    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    faces: NDArray[np.int32]


@dataclass(frozen=True)
class SubmapDescription:
    """What a worker learns about a submap. `descriptor` (d,) float32, L2-normalised; blobs are versioned by `core`."""

    descriptor: NDArray[np.float32]
    place: bytes
    neural_map: bytes | None
    mesh: Mesh
    flags: tuple[str, ...]
    timings_s: dict[str, float]


@dataclass(frozen=True)
class LoopVerdict:
    """Accepted with `T_match_query`, or rejected for `reason`; `evidence` is JSON: what was measured, and the rules."""

    accepted: bool
    reason: str | None
    score: float
    T_match_query: Matrix4 | None
    evidence: dict[str, Any]


class PlaceRecogniser(Protocol):
    """The method, as the workers call it."""

    @property
    def model_version(self) -> str:
        """Descriptors of different versions must not be compared."""
        ...

    def describe(self, submap: Submap, config: PipelineConfig) -> SubmapDescription:
        """Neural map, descriptor and place of a submap. Raises RevisitError where it cannot be described."""
        ...

    def verify(self, query: bytes, match: bytes, similarity: float, config: PipelineConfig) -> LoopVerdict:
        """Compare two places geometrically. Raises DataLoss for damaged ones."""
        ...
