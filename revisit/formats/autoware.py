"""Point cloud maps as Autoware loads them: squares of points as PCD, and what tells where each of them lies."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

SQUARE_M = 20.0
"""The edge of a square, the one that Autoware's own maps are divided by."""

CLOUDS, METADATA, PROJECTOR = "pointcloud_map.pcd", "pointcloud_map_metadata.yaml", "map_projector_info.yaml"
"""The folder of the squares and, beside it, the two files that describe it."""

LOCAL_PROJECTOR = "projector_type: Local\n"
"""A map in metres from a point of its own, not placed on earth."""


def projector_of(origin: tuple[float, float, float]) -> str:
    """The text of `PROJECTOR` for a map in metres east, north and up from `origin`: latitude and longitude, degrees,
    and altitude, metres, of WGS 84.
    """
    latitude, longitude, altitude = origin
    places = f"  latitude: {latitude:.10f}\n  longitude: {longitude:.10f}\n  altitude: {altitude:.4f}\n"
    return f"projector_type: LocalCartesian\nvertical_datum: WGS84\nmap_origin:\n{places}"


Corner = tuple[int, int]
"""The lower left corner of a square, metres in x and y."""


def squares_of(points: NDArray[np.floating]) -> Iterator[tuple[Corner, NDArray[np.int64]]]:
    """The rows of the points (n, 3), metres, in each square that has some, by its corner."""
    corners = (np.floor(points[:, :2] / SQUARE_M) * SQUARE_M).astype(np.int64)
    found, members = np.unique(corners, axis=0, return_inverse=True)
    order = np.argsort(members.ravel(), kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(members.ravel(), minlength=len(found)))[:-1])
    for corner, part in zip(found, parts, strict=True):
        yield (int(corner[0]), int(corner[1])), part


def file_of(corner: Corner) -> str:
    """The name of the file of a square."""
    return f"{corner[0]}_{corner[1]}.pcd"


def metadata_of(corners: Iterable[Corner]) -> str:
    """The text of `METADATA`: the size of squares, and the corner of the one in each file."""
    rows = [f"{file_of(corner)}: [{corner[0]}, {corner[1]}]" for corner in corners]
    return "\n".join([f"x_resolution: {SQUARE_M}", f"y_resolution: {SQUARE_M}", *rows, ""])
