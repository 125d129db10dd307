"""Paths: positions in the order in which they were passed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def travelled_m(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Metres travelled (n,) up to each of the positions (n, 3)."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])
