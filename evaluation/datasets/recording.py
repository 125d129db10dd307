"""The interface of every recording: posed scans, one at a time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.scan import Scan


class Recording(Protocol):
    """Scans in time order. Reading one scan never needs the others in memory."""

    @property
    def name(self) -> str:
        """The name of the recording in reports."""

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """When each scan was taken (n,), nanoseconds."""

    def __len__(self) -> int:
        """How many scans it holds."""

    def pose(self, index: int) -> se3.Matrix4:
        """T_world_sensor of a scan, z up."""

    def scan(self, index: int) -> Scan:
        """The scan with that index, 0-based; raises IndexError beyond the last."""

    def __iter__(self) -> Iterator[Scan]:
        """All scans in order."""
