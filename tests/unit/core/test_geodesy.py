"""Places on earth: closed forms at the equator and the pole, there and back, and a known pair of places."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.geometry import geodesy


@pytest.mark.parametrize(
    ("position", "place"),
    [
        ((0.0, 0.0, 10.0), (6378147.0, 0.0, 0.0)),
        ((0.0, 90.0, 0.0), (0.0, 6378137.0, 0.0)),
        ((90.0, 0.0, 5.0), (0.0, 0.0, 6356757.314245)),
        ((-90.0, 0.0, 0.0), (0.0, 0.0, -6356752.314245)),
    ],
)
def test_earth_centred_coordinates_are_those_of_the_ellipsoid(position, place):
    assert geodesy.ecef([position])[0] == pytest.approx(place, abs=1e-6)


def test_positions_come_back_from_earth_centred_coordinates():
    rng = np.random.default_rng(1)
    given = np.column_stack([rng.uniform(-89.9, 89.9, 500), rng.uniform(-180, 180, 500), rng.uniform(-1e4, 1e5, 500)])
    back = geodesy.geodetic(geodesy.ecef(given))
    assert np.abs(back[:, :2] - given[:, :2]).max() < 1e-9 and np.abs(back[:, 2] - given[:, 2]).max() < 1e-4


def test_metres_from_an_origin_are_those_of_arcs_near_it():
    origin = (48.0, 11.0, 500.0)
    # one second of arc: of the meridian 30.885 m at 48 degrees, of the parallel 20.731 m, at 500 m above the ellipsoid
    north, east, up = geodesy.enu(
        origin, [(48.0 + 1 / 3600, 11.0, 500.0), (48.0, 11.0 + 1 / 3600, 500.0), (48.0, 11.0, 501.0)]
    )
    assert north == pytest.approx([0.0, 30.888, 0.0], abs=2e-3)
    assert east == pytest.approx([20.732, 0.0, 0.0], abs=2e-3)
    assert up == pytest.approx([0.0, 0.0, 1.0], abs=1e-6)
    assert geodesy.geodetic_of_enu(origin, [east])[0] == pytest.approx((48.0, 11.0 + 1 / 3600, 500.0), abs=1e-9)
