"""Fixes of satellites: those that tell a place, and how well."""

from __future__ import annotations

import math

import numpy as np
import pytest

from revisit.formats.satellite_fix import SatelliteFix


def fix(position=(48.1, 11.5, 520.0), status: int = 0, covariance=None) -> SatelliteFix:
    return SatelliteFix(7, "gps", status, position, covariance)


@pytest.mark.parametrize(
    "none",
    [
        fix(status=-1), fix((math.nan, 11.5, 520.0)), fix((48.1, 11.5, math.inf)), fix((0.0, 0.0, 520.0)),
        fix((91.0, 11.5, 0.0)), fix((48.1, -180.5, 0.0)),
    ],
)  # fmt: skip
def test_a_receiver_that_tells_no_place(none) -> None:
    assert not none.is_place


@pytest.mark.parametrize("position", [(48.1, 11.5, 520.0), (0.0, 11.5, 0.0), (-90.0, 180.0, -400.0)])
def test_a_place_on_earth(position) -> None:
    assert fix(position).is_place


def test_a_covariance_that_is_none_is_assumed_by_the_status_and_one_that_is_too_small_is_widened() -> None:
    for told in (None, np.zeros((3, 3)), np.full((3, 3), math.nan), np.diag([1.0, 1.0, -1.0])):
        assert np.diag(fix(status=2, covariance=told).covariance_enu()).tolist() == [0.25, 0.25, 1.0]
    assert np.diag(fix(status=7).covariance_enu()).tolist() == [9.0, 9.0, 36.0]
    np.testing.assert_allclose(fix(covariance=np.diag([1e-8, 4.0, 9.0])).covariance_enu(), np.diag([1e-4, 4.0, 9.0]))
