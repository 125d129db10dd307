"""The normal spectrum: how the faces of the dominant clusters lie to each other (paper III-C; docs/decisions/0015).

For every heading, the vertices that face it are counted along it: walls that look that way are peaks of this profile.
The amplitude spectra of the profiles do not change when the submap moves, and turn with it; the amplitudes of their
harmonics over the heading do not turn either.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from core.clusters import Clusters
from core.config import MicroConfig
from core.surface import Surface

Array = NDArray[np.float32]

_TRANSFORM_SIZE = 256


def normal_spectrum(surface: Surface, clusters: Clusters, config: MicroConfig) -> Array:
    """The spectrum (spectrum_frequencies * (spectrum_harmonics + 1),); zeros where no cluster has a steep face.

    A vertex counts by how steep its face is and less towards `spectrum_reach`, so that a displaced submap loses it
    gradually; the total energy is normalised, so that the number of vertices does not matter.
    """
    chosen = clusters.labels >= 0
    vertices = surface.vertices[chosen, :2].astype(np.float64)
    normals = surface.normals[chosen, :2].astype(np.float64)
    steepness = np.einsum("ij,ij->i", normals, normals)
    nearness = np.clip(1.0 - np.linalg.norm(vertices, axis=1) / config.spectrum_reach, 0.0, 1.0)
    heading = np.arctan2(normals[:, 1], normals[:, 0])
    bins = round(2.0 * config.spectrum_reach / config.spectrum_spacing)
    profiles = _profiles(
        vertices, heading, steepness * nearness, config.spectrum_headings, bins, config.spectrum_spacing,
        config.spectrum_sharpness,
    )  # fmt: skip
    return _harmonics(profiles, config)


@numba.njit(cache=True)
def _profiles(
    vertices: NDArray[np.float64],
    heading: NDArray[np.float64],
    weight: NDArray[np.float64],
    headings: int,
    bins: int,
    spacing: float,
    sharpness: float,
) -> NDArray[np.float64]:
    """Weighted counts (headings, bins) along every heading of the vertices within 60 degrees of facing it."""
    found = np.zeros((headings, bins))
    step = 2.0 * np.pi / headings
    spread = headings // 6
    for vertex in range(len(vertices)):
        if weight[vertex] <= 0.0:
            continue
        nearest = int(np.round(heading[vertex] / step))
        for row in range(nearest - spread, nearest + spread + 1):
            angle = row * step
            facing = np.cos(heading[vertex] - angle)
            if facing <= 0.0:
                continue
            along = vertices[vertex, 0] * np.cos(angle) + vertices[vertex, 1] * np.sin(angle)
            column = int(np.floor(along / spacing)) + bins // 2
            if 0 <= column < bins:
                found[row % headings, column] += weight[vertex] * facing**sharpness
    return found


def _harmonics(profiles: NDArray[np.float64], config: MicroConfig) -> Array:
    amplitude = np.abs(np.fft.rfft(profiles, _TRANSFORM_SIZE, axis=1))
    lowest = 1.0 / (2.0 * config.spectrum_reach)
    frequency = np.linspace(lowest, config.spectrum_highest, config.spectrum_frequencies)
    place = frequency * _TRANSFORM_SIZE * config.spectrum_spacing
    below = np.floor(place).astype(np.int64)
    share = place - below
    polar = amplitude[:, below] * (1.0 - share) + amplitude[:, below + 1] * share
    energy = float(np.linalg.norm(polar))
    if energy == 0.0:
        return np.zeros(config.spectrum_frequencies * (config.spectrum_harmonics + 1), dtype=np.float32)
    over_heading = np.abs(np.fft.rfft(polar * (np.sqrt(polar.size) / energy), axis=0)) / config.spectrum_headings
    return np.asarray(over_heading[: config.spectrum_harmonics + 1].T.ravel(), dtype=np.float32)
