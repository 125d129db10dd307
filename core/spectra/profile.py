"""A description by profiles along all headings, invariant to heading and origin (docs/decisions/0017).

The amplitude spectrum of a profile does not change when the submap moves, and turns with it. Over the heading it is
developed into harmonics: their amplitudes do not turn, and neither do the phases by which the harmonics of neighbouring
frequencies differ.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import PROFILE_BINS, SpectrumConfig

Array = NDArray[np.float32]


def profile_spectrum(profiles: NDArray[np.float64], config: SpectrumConfig) -> Array:
    """The spectrum (`spectrum_size(config)`,) of profiles (headings, bins); zeros where the profiles are.

    Square roots of the amplitudes of the harmonics, then real and imaginary parts of the products of harmonics of
    neighbouring frequencies, their magnitudes compressed alike. The total energy is normalised, so that the number of
    what was counted does not matter.
    """
    polar = _amplitudes(profiles, config)
    energy = float(np.linalg.norm(polar))
    if energy == 0.0:
        return np.zeros(spectrum_size(config), dtype=np.float32)
    harmonics = np.fft.rfft(polar * (np.sqrt(polar.size) / energy), axis=0)[: config.harmonics + 1] / len(polar)
    pieces = [np.sqrt(np.abs(harmonics))]
    for step in range(1, config.neighbours + 1):
        product = harmonics[1:, :-step] * np.conj(harmonics[1:, step:])
        compressed = product / np.maximum(np.abs(product), 1e-12) ** 0.75
        pieces += [compressed.real, compressed.imag]
    return np.concatenate([piece.ravel() for piece in pieces]).astype(np.float32)


def spectrum_size(config: SpectrumConfig) -> int:
    """The length of a spectrum."""
    products = sum(config.frequencies - step for step in range(1, config.neighbours + 1))
    return config.frequencies * (config.harmonics + 1) + 2 * products * config.harmonics


def nearness(places: NDArray[np.float64], config: SpectrumConfig) -> NDArray[np.float64]:
    """Weights (n,) of places (n, 2): from 1 at the origin to 0 at the reach, so that a moved submap loses gradually."""
    x, y = places.T
    return np.asarray(np.clip(1.0 - np.sqrt(x * x + y * y) / config.reach, 0.0, 1.0))


def bin_count(config: SpectrumConfig) -> int:
    """How many bins a profile has."""
    return round(2.0 * config.reach / config.spacing)


def _amplitudes(profiles: NDArray[np.float64], config: SpectrumConfig) -> NDArray[np.float64]:
    """Amplitudes (headings, frequencies) of the profiles from one period over the whole reach up to `highest`."""
    amplitude = np.abs(np.fft.rfft(profiles, PROFILE_BINS, axis=1))
    frequency = np.linspace(1.0 / (2.0 * config.reach), config.highest, config.frequencies)
    place = frequency * PROFILE_BINS * config.spacing
    below = np.floor(place).astype(np.int64)
    share = place - below
    return np.asarray(amplitude[:, below] * (1.0 - share) + amplitude[:, below + 1] * share)
