"""The plan spectrum: how the standing structure lies, far beyond the BEV image (docs/decisions/0017).

Seen from above, the vertices of the dominant clusters are counted along every heading, which is the Radon transform of
the plan; taller structure has more of them.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from revisit.core.clusters import Clusters
from revisit.core.config import SpectrumConfig
from revisit.core.spectra.profile import bin_count, nearness, profile_spectrum
from revisit.core.surface import Surface

Array = NDArray[np.float32]


def plan_spectrum(surface: Surface, clusters: Clusters, config: SpectrumConfig) -> Array:
    """The spectrum (`spectrum_size(config)`,) of the plan; zeros where there is no cluster within reach."""
    places = surface.vertices[clusters.labels >= 0, :2].astype(np.float64)
    profiles = _projections(places, nearness(places, config), config.headings, bin_count(config), config.spacing)
    return profile_spectrum(profiles, config)


@numba.njit(cache=True)
def _projections(
    places: NDArray[np.float64], weight: NDArray[np.float64], headings: int, bins: int, spacing: float
) -> NDArray[np.float64]:
    """Weighted counts (headings, bins) along headings over half a turn: the other half mirrors them."""
    found = np.zeros((headings, bins))
    for row in range(headings):
        cosine, sine = np.cos(row * np.pi / headings), np.sin(row * np.pi / headings)
        for place in range(len(places)):
            column = int(np.floor((places[place, 0] * cosine + places[place, 1] * sine) / spacing)) + bins // 2
            if 0 <= column < bins:
                found[row, column] += weight[place]
    return found
