"""The log-Gabor bank and the maximum index map (paper III-D)."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.bev.log_gabor import filter_bank, maximum_index_map
from revisit.core.config import BevConfig


def test_each_filter_peaks_at_its_wavelength_and_direction() -> None:
    bank = filter_bank(120, 4, 6, 3.0, 1.6, 0.75)
    for scale, wavelength in enumerate((3.0, 4.8, 7.68, 12.288)):
        row, column = np.unravel_index(bank[0, scale].argmax(), (120, 120))
        assert row == 0  # orientation 0 is the direction of x
        assert column == pytest.approx(120 / wavelength, abs=0.5)


def test_no_filter_answers_to_a_constant_image() -> None:
    assert filter_bank(64, 4, 6, 3.0, 1.6, 0.75)[:, :, 0, 0].max() == 0.0


@pytest.mark.parametrize("orientation", range(6))
def test_a_grating_is_labelled_with_the_direction_of_its_change(orientation: int) -> None:
    angle = orientation * np.pi / 6
    row, column = np.mgrid[0:100, 0:100]
    grating = 0.5 + 0.5 * np.cos(2 * np.pi / 5.0 * (column * np.cos(angle) + row * np.sin(angle)))
    labels = maximum_index_map(grating.astype(np.float32), BevConfig()).index
    assert (labels[30:70, 30:70] == orientation).all()
