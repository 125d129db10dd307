"""The normal spectrum: how the faces of the dominant clusters lie to each other (paper III-C; docs/decisions/0017).

For every heading, the vertices that face it are counted along it: walls that look that way are peaks of this profile.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.clusters import Clusters
from revisit.core.config import SpectrumConfig
from revisit.core.kernels.heading_profiles import face_profiles
from revisit.core.spectra.profile import bin_count, nearness, profile_spectrum
from revisit.core.surface import Surface

Array = NDArray[np.float32]


def normal_spectrum(surface: Surface, clusters: Clusters, config: SpectrumConfig) -> Array:
    """The spectrum (`spectrum_size(config)`,) of the faces; zeros where no cluster within reach has a steep face.

    A vertex counts by how steep its face is and by its nearness.
    """
    chosen = np.flatnonzero(clusters.labels >= 0)
    vertices = surface.vertices.take(chosen, axis=0)[:, :2].astype(np.float64)
    normals = surface.normals.take(chosen, axis=0)[:, :2].astype(np.float64)
    weight = np.einsum("ij,ij->i", normals, normals) * nearness(vertices, config)
    heading = np.arctan2(normals[:, 1], normals[:, 0])
    profiles = face_profiles(
        vertices, heading, weight, config.headings, bin_count(config), config.spacing, config.sharpness
    )
    return profile_spectrum(profiles, config)
