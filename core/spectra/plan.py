"""The plan spectrum: how the standing structure lies, far beyond the BEV image (docs/decisions/0017).

Seen from above, the vertices of the dominant clusters are counted along every heading, which is the Radon transform of
the plan; taller structure has more of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.clusters import Clusters
from revisit.core.config import SpectrumConfig
from revisit.core.kernels.heading_profiles import plan_profiles
from revisit.core.spectra.profile import bin_count, nearness, profile_spectrum
from revisit.core.surface import Surface

Array = NDArray[np.float32]


def plan_spectrum(surface: Surface, clusters: Clusters, config: SpectrumConfig) -> Array:
    """The spectrum (`spectrum_size(config)`,) of the plan; zeros where there is no cluster within reach."""
    chosen = np.flatnonzero(clusters.labels >= 0)
    places = surface.vertices.take(chosen, axis=0)[:, :2].astype(np.float64)
    profiles = plan_profiles(places, nearness(places, config), config.headings, bin_count(config), config.spacing)
    return profile_spectrum(profiles, config)
