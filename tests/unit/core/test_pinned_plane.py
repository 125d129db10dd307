"""A picture laid on the ground by two pins."""

from __future__ import annotations

import math

import pytest

from revisit.core.geometry.pinned_plane import PinnedPlane


def test_two_pins_scale_turn_and_move_a_picture():
    # Ten pixels to the right are five metres north: half a metre a pixel, a quarter turn.
    plane = PinnedPlane.by(((0, 0), (10, 0)), ((3.0, 4.0), (3.0, 9.0)))
    assert plane.metres_per_pixel == pytest.approx(0.5) and plane.turn_rad == pytest.approx(math.pi / 2)
    # Down in the picture is then east.
    assert plane.at((0, 10)) == pytest.approx((8.0, 4.0))


def test_a_picture_is_not_mirrored():
    plane = PinnedPlane.by(((0, 0), (100, 0)), ((0.0, 0.0), (10.0, 0.0)))
    assert plane.at((0, 100)) == pytest.approx((0.0, -10.0))


def test_two_pins_at_one_pixel_hold_nothing():
    with pytest.raises(ValueError, match="one pixel"):
        PinnedPlane.by(((1, 1), (1, 1)), ((0.0, 0.0), (1.0, 0.0)))
