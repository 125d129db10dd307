"""The layout spectrum: a global cue of the BEV image that neither heading nor offset changes (docs/decisions/0017).

The amplitude spectrum of an image does not move with the image, and turns with it; the amplitudes of its harmonics over
the angle do not turn either.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import gaussian_filter, map_coordinates

from revisit.core.config import BevConfig

Array = NDArray[np.float32]


def layout_spectrum(image: Array, config: BevConfig) -> Array:
    """The layout spectrum (layout_radii * (layout_harmonics + 1),) of a BEV image (H, H) in 0..1; zeros if black.

    Tall structure counts more (`layout_power`), the rim fades out so that a displaced submap loses it gradually, and
    the total energy is normalised, so that the density of the returns does not matter.
    """
    size = _transform_size(image.shape[0])
    smooth = gaussian_filter(image**config.layout_power, config.layout_blur)
    amplitude = np.abs(fft.fftshift(fft.fft2(smooth * _fading_rim(image.shape[0]), (size, size))))
    energy = float(np.linalg.norm(amplitude))
    if energy == 0.0:
        return np.zeros(config.layout_radii * (config.layout_harmonics + 1), dtype=np.float32)
    places = _polar_places(size, config.layout_radii, config.layout_angles, config.layout_frequency)
    polar = map_coordinates(amplitude * (size / energy), places, order=1)
    harmonics = np.abs(np.fft.rfft(polar, axis=1))[:, : config.layout_harmonics + 1] / config.layout_angles
    return np.asarray(harmonics.ravel(), dtype=np.float32)


def _transform_size(pixels: int) -> int:
    return 1 << (pixels - 1).bit_length()


@lru_cache(maxsize=4)
def _fading_rim(pixels: int) -> Array:
    """Weights (H, H) that fall from 1 at the centre to 0 at half the image's edge."""
    axis = (np.arange(pixels) + 0.5 - pixels / 2) / (pixels / 2)
    return np.asarray(np.clip(1.0 - np.hypot(axis[:, None], axis[None, :]), 0.0, 1.0), dtype=np.float32)


@lru_cache(maxsize=4)
def _polar_places(size: int, radii: int, angles: int, highest: float) -> NDArray[np.float64]:
    """Rows and columns (2, radii, angles) of a polar raster over half of a shifted spectrum, up to `highest` cycles/px.

    Half a turn suffices, since the amplitudes of a real image are symmetric.
    """
    radius = np.linspace(1.5 / size, highest, radii) * size
    angle = np.arange(angles) * np.pi / angles
    return np.stack([size / 2 + np.outer(radius, np.sin(angle)), size / 2 + np.outer(radius, np.cos(angle))])
