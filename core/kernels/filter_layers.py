"""Filtering an image by many filters in the frequency domain: products, amplitudes, strongest answer (paper III-D)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import compiled, loop

Array = NDArray[np.float32]
Complex = NDArray[np.complex64]


@loop
def multiply_spectrum(filters: Array, spectrum: Complex, products: Complex) -> None:
    """Write the `spectrum` (h, w) times each of the `filters` (s, h, w) into `products` (s, h, w)."""
    scales, height, width = filters.shape
    for s in range(scales):
        for y in range(height):
            for x in range(width):
                products[s, y, x] = spectrum[y, x] * filters[s, y, x]


@loop
def add_amplitudes(responses: Complex, total: Array) -> None:
    """Add the moduli of `responses` (s, h, w) to `total` (h', w'), whose edges are at most as long."""
    height, width = total.shape
    for s in range(len(responses)):
        for y in range(height):
            for x in range(width):
                value = responses[s, y, x]
                total[y, x] += np.sqrt(value.real * value.real + value.imag * value.imag)


@compiled
def strongest_layer(layers: Array) -> tuple[NDArray[np.int8], Array]:
    """Which of `layers` (l, h, w) is the greatest at each pixel, the first of equal ones, and its value there."""
    count, height, width = layers.shape
    index, value = np.zeros((height, width), dtype=np.int8), layers[0].copy()
    for layer in range(1, count):
        for y in range(height):
            for x in range(width):
                if layers[layer, y, x] > value[y, x]:
                    value[y, x] = layers[layer, y, x]
                    index[y, x] = layer
    return index, value
