"""A recording that is made harder: what is left of a scan."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.evaluation.perturbations import Perturbation


def ring(count: int = 360) -> np.ndarray:
    """A point in each degree around the sensor (count, 3), the first one behind it."""
    angle = np.radians(np.arange(count) - 179.5)
    return np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1).astype(np.float32)


def test_a_view_is_as_wide_as_said_and_looks_ahead() -> None:
    left = Perturbation(view_deg=120.0).thin(ring(), 0)
    angle = np.degrees(np.arctan2(left[:, 1], left[:, 0]))
    assert len(left) == 120
    assert (angle.min(), angle.max()) == pytest.approx((-59.5, 59.5), abs=1e-3)


def test_a_whole_turn_is_left_as_it_is() -> None:
    points = ring()
    assert Perturbation().thin(points, 0) is points


@pytest.mark.parametrize("width", [0.0, -10.0, 361.0, float("nan")])
def test_a_view_of_no_width_or_more_than_a_turn_is_refused(width: float) -> None:
    with pytest.raises(ValueError, match="view_deg"):
        Perturbation(view_deg=width)
