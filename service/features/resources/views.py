"""Submaps and operations as clients see them: their rows, and what is read with these."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from revisit.service.domain.records import JobRecord, SubmapRecord
from revisit.service.features.graph.map_frames import MapPose


@dataclass(frozen=True, kw_only=True)
class SubmapView(SubmapRecord):
    """A submap; `in_map` is T_map_submap where its session has a frame.

    `place_descriptor` (d,) is there where it was asked for and the submap is described.
    """

    in_map: MapPose | None = None
    place_descriptor: NDArray[np.float32] | None = field(default=None, compare=False)

    @classmethod
    def of(cls, record: SubmapRecord, in_map: MapPose | None = None) -> Self:
        """The view of a row."""
        return cls(**vars(record), in_map=in_map)


@dataclass(frozen=True)
class PostedOperation:
    """An operation that was asked for, and whether the same one waited already."""

    operation: JobRecord
    replay: bool
