"""Log-Gabor filters of several scales and orientations, and the maximum index map (paper III-D)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from revisit.core.config import BevConfig
from revisit.core.kernels.filter_layers import add_amplitudes, multiply_spectrum, strongest_layer

Array = NDArray[np.float32]


@dataclass(frozen=True)
class OrientationMap:
    """Which orientation answers strongest at each pixel, and how strongly.

    index (H, W) int8 in 0..orientations-1, the maximum index map; amplitude (H, W) float32, the response of that
    orientation summed over the scales. Orientation o is the direction o * pi / orientations of strongest change.
    """

    index: NDArray[np.int8]
    amplitude: Array
    orientations: int


@lru_cache(maxsize=4)
def filter_bank(size: int, scales: int, orientations: int, wavelength: float, factor: float, sigma: float) -> Array:
    """The filters (orientations, scales, size, size) in the frequency domain, zero frequency first.

    Radial part: Gaussian on the logarithmic frequency axis around 1 / (wavelength * factor^s) cycles per pixel, with
    bandwidth `sigma` = sigma/f. Angular part: Gaussian around o * pi / orientations, one-sided, so that the modulus
    of the filtered image is the local energy. Source: Field 1987; Kovesi, phase congruency.
    """
    frequency_y, frequency_x = np.meshgrid(fft.fftfreq(size), fft.fftfreq(size), indexing="ij")
    radius = np.hypot(frequency_x, frequency_y)
    radius[0, 0] = 1.0
    direction = np.arctan2(frequency_y, frequency_x)
    centres = 1.0 / (wavelength * factor ** np.arange(scales))
    radial = np.exp(-(np.log(radius / centres[:, None, None]) ** 2) / (2.0 * np.log(sigma) ** 2))
    radial[:, 0, 0] = 0.0
    spread = np.pi / orientations / 1.3
    angles = np.arange(orientations) * np.pi / orientations
    gap = np.abs((direction - angles[:, None, None] + np.pi) % (2.0 * np.pi) - np.pi)
    angular = np.exp(-(gap**2) / (2.0 * spread**2))
    return np.asarray(angular[:, None] * radial, dtype=np.float32)


def maximum_index_map(image: Array, config: BevConfig) -> OrientationMap:
    """Filter the (H, W) image, add the amplitudes of the scales, keep the strongest orientation of every pixel."""
    height, width = image.shape
    size = fft.next_fast_len(max(height, width) + config.filter_margin)
    bank = filter_bank(
        size, config.scales, config.orientations, config.wavelength, config.scale_factor, config.bandwidth
    )
    return OrientationMap(*strongest_orientations(image, bank), config.orientations)


def strongest_orientations(image: Array, bank: Array) -> tuple[NDArray[np.int8], Array]:
    """Which orientation of the filters `bank` (o, s, k, k) answers strongest in the `image` (h, w), and how."""
    (height, width), (orientations, scales, size, _) = image.shape, bank.shape
    spectrum = fft.fft2(image, s=(size, size)) / np.float32(size * size)  # the transforms back do not divide
    amplitude = np.zeros((orientations, height, width), dtype=np.float32)
    response = np.empty((1, size, size), dtype=np.complex64)
    parts = response.view(np.float32).reshape(size, size, 2)
    for filters, layer in zip(bank, amplitude, strict=True):
        for scale in range(scales):  # one at a time stays in the cache
            multiply_spectrum(filters[scale : scale + 1], spectrum, response)
            cv2.dft(parts, parts, flags=cv2.DFT_INVERSE | cv2.DFT_COMPLEX_OUTPUT)
            add_amplitudes(response, layer)
    return strongest_layer(amplitude)
