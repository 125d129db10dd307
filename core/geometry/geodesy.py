"""Places on earth: latitude, longitude and altitude of WGS 84, and metres east, north and up from an origin.

A geodetic position is (latitude, longitude, altitude): degrees, degrees, metres above the ellipsoid. Formulas are those
of Snyder, Map Projections (1987), and of Bowring (1985) for the way back.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from revisit.core.geometry import se3

Array64 = NDArray[np.float64]

SEMI_MAJOR_M = 6378137.0
FLATTENING = 1.0 / 298.257223563
_SEMI_MINOR_M = SEMI_MAJOR_M * (1.0 - FLATTENING)
_ECCENTRICITY_2 = FLATTENING * (2.0 - FLATTENING)


def ecef(positions: ArrayLike) -> Array64:
    """Earth-centred, earth-fixed coordinates (n, 3), metres, of geodetic positions (n, 3)."""
    given = np.asarray(positions, dtype=np.float64)
    latitude, longitude, altitude = np.radians(given[:, 0]), np.radians(given[:, 1]), given[:, 2]
    radius = SEMI_MAJOR_M / np.sqrt(1.0 - _ECCENTRICITY_2 * np.sin(latitude) ** 2)
    across = (radius + altitude) * np.cos(latitude)
    up = ((1.0 - _ECCENTRICITY_2) * radius + altitude) * np.sin(latitude)
    return np.column_stack([across * np.cos(longitude), across * np.sin(longitude), up])


def geodetic(places: ArrayLike) -> Array64:
    """The geodetic positions (n, 3) of earth-centred coordinates (n, 3); within 0.1 mm from sea to space."""
    x, y, z = np.asarray(places, dtype=np.float64).T
    across = np.hypot(x, y)
    second = _ECCENTRICITY_2 / (1.0 - _ECCENTRICITY_2)
    reduced = np.arctan2(z * SEMI_MAJOR_M, across * _SEMI_MINOR_M)
    for _ in range(3):
        above = z + second * _SEMI_MINOR_M * np.sin(reduced) ** 3
        beside = across - _ECCENTRICITY_2 * SEMI_MAJOR_M * np.cos(reduced) ** 3
        latitude = np.arctan2(above, beside)
        reduced = np.arctan2((1.0 - FLATTENING) * np.sin(latitude), np.cos(latitude))
    radius = SEMI_MAJOR_M / np.sqrt(1.0 - _ECCENTRICITY_2 * np.sin(latitude) ** 2)
    altitude = across * np.cos(latitude) + z * np.sin(latitude) - SEMI_MAJOR_M**2 / radius
    return np.column_stack([np.degrees(latitude), np.degrees(np.arctan2(y, x)), altitude])


def T_ecef_enu(origin: ArrayLike) -> se3.Matrix4:
    """From metres east, north and up of a geodetic position (3,) to earth-centred coordinates."""
    given = np.asarray(origin, dtype=np.float64)
    latitude, longitude = math.radians(given[0]), math.radians(given[1])
    east = [-math.sin(longitude), math.cos(longitude), 0.0]
    up = [math.cos(latitude) * math.cos(longitude), math.cos(latitude) * math.sin(longitude), math.sin(latitude)]
    return se3.from_rotation_translation(np.column_stack([east, np.cross(up, east), up]), ecef(given[None])[0])


def enu(origin: ArrayLike, positions: ArrayLike) -> Array64:
    """Metres (n, 3) east, north and up from `origin` (3,) of geodetic positions (n, 3)."""
    return se3.apply(se3.inverse(T_ecef_enu(origin)), ecef(positions))


def geodetic_of_enu(origin: ArrayLike, places: ArrayLike) -> Array64:
    """The geodetic positions (n, 3) of places (n, 3) in metres east, north and up from `origin` (3,)."""
    return geodetic(se3.apply(T_ecef_enu(origin), np.asarray(places, dtype=np.float64)))
