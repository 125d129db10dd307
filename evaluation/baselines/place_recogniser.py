"""The interface of every baseline: a descriptor of a cloud, and a similarity of descriptors."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from revisit.core.scan import Points

Descriptor = NDArray[Any]


class PlaceRecogniser(Protocol):
    """A place-recognition method without state: the same cloud gives the same descriptor."""

    @property
    def name(self) -> str:
        """The name of the method in reports."""

    def describe(self, points: Points) -> Descriptor:
        """The descriptor of a cloud (n, 3), metres, z up, seen from its origin."""

    def similarities(self, query: Descriptor, places: Descriptor) -> NDArray[np.float64]:
        """How alike the query is to each of m places (m, ...): (m,), higher is more alike."""
