"""The layout spectrum: what does not change it, and what does."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter, rotate, shift

from revisit.core.bev.layout import layout_spectrum
from revisit.core.config import BevConfig

CONFIG = BevConfig()


def yard(seed: int) -> np.ndarray:
    """A 250 pixel image of walls around its middle, black towards the rim."""
    rng = np.random.default_rng(seed)
    image = np.zeros((250, 250))
    for _ in range(12):
        row, column = rng.integers(80, 165, 2)
        height, width = (2, rng.integers(10, 40)) if rng.random() < 0.5 else (rng.integers(10, 40), 2)
        image[row : row + height, column : column + width] = rng.uniform(0.5, 1.0)
    return gaussian_filter(image, 1.0).astype(np.float32)


def likeness(a: np.ndarray, b: np.ndarray) -> float:
    one, other = layout_spectrum(a.astype(np.float32), CONFIG), layout_spectrum(b.astype(np.float32), CONFIG)
    return float(np.linalg.norm(one - other) / np.linalg.norm(one))


def test_turning_the_image_changes_little_and_another_yard_changes_much():
    image = yard(1)
    turned = np.clip(rotate(image, 37.0, reshape=False, order=1), 0, 1)
    assert likeness(image, turned) < 0.1
    assert likeness(image, yard(2)) > 3 * likeness(image, turned)


def test_half_a_turn_changes_nothing():
    image = yard(3)
    assert likeness(image, image[::-1, ::-1]) < 1e-4


def test_moving_the_image_by_four_metres_changes_less_than_another_yard():
    image = yard(4)
    assert likeness(image, shift(image, (10, 0), order=0)) < 0.5 * likeness(image, yard(5))


def test_fainter_evidence_changes_nothing():
    image = yard(6)
    assert likeness(image, 0.5 * image) < 1e-4


def test_a_black_image_has_a_zero_spectrum():
    spectrum = layout_spectrum(np.zeros((250, 250), np.float32), CONFIG)
    assert spectrum.shape == (24 * 7,) and not spectrum.any()


def test_a_grating_puts_its_energy_at_its_frequency():
    column = np.arange(250)
    grating = np.tile((0.5 + 0.5 * np.cos(2 * np.pi * 0.1 * column)) ** 0.5, (250, 1)).astype(np.float32)
    mean_over_angles = layout_spectrum(grating, CONFIG).reshape(24, 7)[:, 0]
    frequencies = np.linspace(1.5 / 256, CONFIG.layout_frequency, 24)
    away_from_zero = frequencies > 0.03
    peak = frequencies[away_from_zero][mean_over_angles[away_from_zero].argmax()]
    assert abs(peak - 0.1) < 0.01
