"""RING (Lu et al., RAL 2022): Radon transform of the BEV; yaw becomes a shift, translation a phase that FFT drops."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from revisit.core.scan import Points
from revisit.evaluation.baselines.place_recogniser import Descriptor


@dataclass(frozen=True)
class Ring:
    """BEV of +- `half_range_m` in `bins` pixels, `angles` projections over the half turn."""

    half_range_m: float = 70.0
    bins: int = 120
    angles: int = 120
    min_height_m: float = -1.2

    @property
    def name(self) -> str:
        """The name of the method in reports."""
        return "ring"

    def describe(self, points: Points) -> Descriptor:
        """Magnitudes (angles, bins // 2) of the spectra of the projections, every row of length 1.

        Points lower than `min_height_m` below the sensor are ground and left out.
        """
        image = self._bev(points)
        occupied = np.argwhere(image > 0)
        centre = (occupied + 0.5) / self.bins * 2 * self.half_range_m - self.half_range_m
        along = centre @ self._directions.T
        index = np.floor((along + self.half_range_m) / (2 * self.half_range_m) * self.bins).astype(np.int64)
        weight = np.where((index >= 0) & (index < self.bins), image[tuple(occupied.T)][:, None], 0.0)
        flat = np.clip(index, 0, self.bins - 1) + np.arange(self.angles) * self.bins
        sinogram = np.bincount(flat.ravel(), weight.ravel(), self.angles * self.bins).reshape(self.angles, self.bins)
        spectrum = np.abs(np.fft.rfft(sinogram, axis=1))[:, 1 : self.bins // 2 + 1]
        return np.asarray(spectrum / max(float(np.linalg.norm(spectrum)), 1e-9), dtype=np.float32)

    def similarities(self, query: Descriptor, places: NDArray[np.float32]) -> NDArray[np.float64]:
        """Highest circular cross-correlation over the angles, 1 for equal places."""
        query_spectrum = np.fft.rfft(query, axis=0)
        product = (np.conj(query_spectrum)[None] * np.fft.rfft(places, axis=1)).sum(axis=2)
        return np.asarray(np.fft.irfft(product, n=self.angles, axis=1).max(axis=1), dtype=np.float64)

    @cached_property
    def _directions(self) -> NDArray[np.float64]:
        angle = np.pi * np.arange(self.angles) / self.angles
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def _bev(self, points: Points) -> NDArray[np.float64]:
        above = points[points[:, 2] > self.min_height_m]
        limits = [[-self.half_range_m, self.half_range_m]] * 2
        counts = np.histogram2d(above[:, 0], above[:, 1], bins=self.bins, range=limits)[0]
        return np.asarray(counts > 0, dtype=np.float64)
