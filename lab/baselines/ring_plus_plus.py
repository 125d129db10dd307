"""RING++ (Xu et al., TRO 2023): the Radon transform of several local-feature images instead of one occupancy image."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from revisit.core.scan import Points
from revisit.evaluation.baselines.place_recogniser import Descriptor

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class RingPlusPlus:
    """Images of +- `half_range_m` in `bins` pixels; `angles` projections; the `frequencies` lowest of each are kept.

    Channels are features of the eigenvalues of all points around a pixel. Unlike RING (`lab.baselines.ring`),
    the translation, which the magnitudes leave open, is not solved here: this compares places only.
    """

    half_range_m: float = 70.0
    bins: int = 120
    angles: int = 120
    frequencies: int = 30
    min_height_m: float = -1.2

    @property
    def name(self) -> str:
        """The name of the method in reports."""
        return "ring++"

    def describe(self, points: Points) -> Descriptor:
        """(2, channels, angles // 2 + 1, frequencies): real and imaginary part of the spectrum over the angles.

        Each channel is of length 1 before that transform, so that its energy does not depend on the density.
        """
        above = points[points[:, 2] > self.min_height_m].astype(np.float64)
        channels = self._features(above)
        occupied = np.argwhere(channels.any(axis=0))
        centre = (occupied + 0.5) / self.bins * 2 * self.half_range_m - self.half_range_m
        along = centre @ self._directions.T
        index = np.floor((along + self.half_range_m) / (2 * self.half_range_m) * self.bins).astype(np.int64)
        inside = (index >= 0) & (index < self.bins)
        flat = (np.clip(index, 0, self.bins - 1) + np.arange(self.angles) * self.bins).ravel()
        spectra = []
        for channel in channels:
            weight = np.where(inside, channel[tuple(occupied.T)][:, None], 0.0)
            sums = np.bincount(flat, weight.ravel(), self.angles * self.bins).reshape(self.angles, self.bins)
            magnitude = np.abs(np.fft.rfft(sums, axis=1))[:, 1 : self.frequencies + 1]
            spectra.append(np.fft.rfft(magnitude / max(float(np.linalg.norm(magnitude)), 1e-9), axis=0))
        stacked = np.stack(spectra)
        return np.stack([stacked.real, stacked.imag]).astype(np.float32)

    def similarities(self, query: Descriptor, places: Descriptor) -> NDArray[np.float64]:
        """Highest circular cross-correlation over the angles, the mean of the channels; 1 for equal places."""
        asked = np.conj(query[0] + 1j * query[1])
        product = np.einsum("cwf,mcwf->mw", asked, places[:, 0] + 1j * places[:, 1], optimize=True)
        correlation = np.fft.irfft(product, n=self.angles, axis=1).max(axis=1)
        return np.asarray(correlation / query.shape[1], dtype=np.float64)

    @cached_property
    def _directions(self) -> Floats:
        angle = np.pi * np.arange(self.angles) / self.angles
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def _features(self, points: Floats) -> Floats:
        """(6, bins, bins): linearity, planarity, scattering, omnivariance, eigenentropy, change of curvature.

        From the covariance of the points of a pixel and its eight neighbours; 0 where fewer than five lie.
        """
        count, first, second = self._moments(points)
        enough = count >= 5
        mean = first[enough] / count[enough][:, None]
        covariance = second[enough] / count[enough][:, None, None] - mean[:, :, None] * mean[:, None]
        values = np.clip(np.linalg.eigvalsh(covariance)[:, ::-1], 1e-9, None)
        images = np.zeros((6, self.bins, self.bins))
        images[:, enough] = _eigenvalue_features(values)
        return images

    def _moments(self, points: Floats) -> tuple[Floats, Floats, Floats]:
        """Number (b, b), sums (b, b, 3) and sums of products (b, b, 3, 3) of the points around every pixel."""
        pixel = np.floor((points[:, :2] + self.half_range_m) / (2 * self.half_range_m) * self.bins).astype(np.int64)
        inside = ((pixel >= 0) & (pixel < self.bins)).all(axis=1)
        flat, kept = pixel[inside, 0] * self.bins + pixel[inside, 1], points[inside]
        columns = [np.ones(len(kept)), *kept.T, *(kept[:, i] * kept[:, j] for i in range(3) for j in range(3))]
        sums = np.stack([np.bincount(flat, column, self.bins**2) for column in columns], axis=1, dtype=np.float64)
        around = _neighbour_sums(sums.reshape(self.bins, self.bins, 13))
        return around[..., 0], around[..., 1:4], around[..., 4:].reshape(self.bins, self.bins, 3, 3)


def _neighbour_sums(grid: Floats) -> Floats:
    """Each pixel's value plus those of its eight neighbours, (b, b, k)."""
    padded = np.pad(grid, ((1, 1), (1, 1), (0, 0)))
    size = len(grid)
    return np.asarray(sum(padded[i : i + size, j : j + size] for i in range(3) for j in range(3)))


def _eigenvalue_features(values: Floats) -> Floats:
    """The six features (6, n) of eigenvalues (n, 3), the largest first."""
    share = values / values.sum(axis=1, keepdims=True)
    large, middle, small = share.T
    return np.stack([
        (large - middle) / large, (middle - small) / large, small / large, np.cbrt(large * middle * small),
        -(share * np.log(share)).sum(axis=1), small,
    ])  # fmt: skip
