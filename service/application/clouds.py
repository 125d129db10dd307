"""Clouds on their way in: encoded by the client or already decoded by a transport; validated; packed for storage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from core.scan import Points

if TYPE_CHECKING:
    from core.formats import DecodedCloud


@dataclass(frozen=True)
class EncodedCloud:
    """Bytes as the client sent them (after removal of any transport compression), with their content type."""

    data: bytes
    content_type: str


CloudInput: TypeAlias = "EncodedCloud | DecodedCloud"


@dataclass(frozen=True)
class StoredCloud:
    """What is kept of a cloud: finite points (n, 3) float32 metres in the sensor frame, and intensity (n,) if sent."""

    points: Points
    intensity: NDArray[np.float32] | None
