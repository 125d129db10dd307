"""The first stored form of a place, which is still read."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.container import Container
from revisit.core.errors import DataLoss
from revisit.core.geometry import octahedral
from revisit.core.place_form import DIMENSIONS, MAX_ROWS, PlaceContents, bounded, directions

Array = NDArray[np.float32]

CONTAINER = Container(b"RVPS\x01", "stored place", level=9, max_body_bytes=4_000_000, digest_bytes=16, body_length=True)
_CENTIMETRE = np.float32(0.01)
_NORMAL_STEPS = 127


def read_first_form(header: dict[str, Any], body: bytes) -> PlaceContents:
    """The arrays of a blob of the first form. Raises DataLoss where the body has not the announced size.

    Of its descriptors those numbers that the present form keeps, so that places of both can be compared.
    """
    count, size, rows, standing = (
        bounded(header, name, MAX_ROWS) for name in ("keypoints", "size", "points", "standing")
    )
    ends = np.cumsum([6 * count, size + count * size, 8 * rows])
    if len(body) != ends[-1] or standing > rows:
        raise DataLoss("the place's sections do not have the announced sizes")
    keypoints, orientations = _keypoints(body[: ends[0]], count)
    parity, descriptors = _descriptors(body[ends[0] : ends[1]], count, size)
    points, normals = _points(body[ends[1] :], rows)
    return PlaceContents(keypoints, orientations, descriptors, parity, points, normals, standing)


def _keypoints(data: bytes, count: int) -> tuple[Array, Array]:
    positions = np.frombuffer(data, "<i2", 2 * count).reshape(2, count).T
    angles = np.frombuffer(data, "<u2", count, 4 * count)
    return positions * _CENTIMETRE, (angles * (np.pi / 65536.0)).astype(np.float32)


def _descriptors(data: bytes, count: int, size: int) -> tuple[Array, Array]:
    parity = np.frombuffer(data, np.int8, size).astype(np.float32)
    levels = np.frombuffer(data, np.int8, count * size, size).reshape(size, count).T.astype(np.float32)
    return parity[:DIMENSIONS], directions(levels[:, :DIMENSIONS])


def _points(data: bytes, rows: int) -> tuple[Array, Array]:
    differences = np.frombuffer(data, "<i2", 3 * rows).reshape(3, rows).T
    codes = np.frombuffer(data, np.uint8, 2 * rows, 6 * rows).reshape(2, rows).T
    normals = octahedral.decode(codes, _NORMAL_STEPS).astype(np.float32)
    return np.cumsum(differences, axis=0, dtype=np.int16) * _CENTIMETRE, normals
