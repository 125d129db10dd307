"""The stored form of a place: small, exact after the first quantisation, strict."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from revisit.core.errors import DataLoss
from revisit.core.geometry import se3
from revisit.core.geometry.level_frame import LevelFrame
from revisit.core.place import CONTAINER, Place
from tests.support.yards import recognised, yard


@lru_cache(maxsize=1)
def stored() -> Place:
    """The place of a yard."""
    return recognised(yard(1))[1]


def test_a_place_survives_its_blob_bit_by_bit() -> None:
    blob = stored().to_blob()
    restored = Place.from_blob(blob)
    for name in ("keypoints", "orientations", "descriptors", "parity", "points", "normals"):
        np.testing.assert_array_equal(getattr(restored, name), getattr(stored(), name), err_msg=name)
    assert restored.standing_count == stored().standing_count
    assert restored.to_blob() == blob


def test_the_stored_frame_is_the_inverse_of_the_similarity_and_returns_within_rounding() -> None:
    frame = LevelFrame.from_upright(se3.exp([1.0, 2.0, 3.0, 0.1, -0.2, 0.05]), 0.25)
    blob = replace(stored(), frame=frame).to_blob()
    header, _ = CONTAINER.unpack(blob)
    np.testing.assert_array_equal(header["T_level_submap"], np.linalg.inv(frame.similarity)[:3])
    restored = Place.from_blob(blob).frame
    np.testing.assert_allclose(restored.similarity, frame.similarity, atol=1e-12)
    assert restored.scale == pytest.approx(0.25, rel=1e-12)


@pytest.mark.parametrize(
    "matrix", [np.zeros((3, 4)), np.diag([1.0, 2.0, 1.0, 0.0])[:3], 1e-200 * np.eye(3, 4), np.eye(2), "turned"]
)
def test_a_stored_frame_that_is_no_similarity_is_refused(matrix: object) -> None:
    header = {"keypoints": 0, "size": 0, "points": 0, "standing": 0, "model": "m"}
    rows = matrix.tolist() if isinstance(matrix, np.ndarray) else matrix
    with pytest.raises(DataLoss, match="level frame"):
        Place.from_blob(CONTAINER.pack(header | {"T_level_submap": rows}, b""))


def test_a_place_fits_into_40_kilobytes() -> None:
    assert len(stored().to_blob()) <= 40_000


def test_quantisation_moves_points_by_less_than_a_centimetre_and_normals_by_less_than_a_degree() -> None:
    surface = yard(1)
    lookup = {tuple(np.rint(p * 100).astype(int)): n for p, n in zip(surface.vertices, surface.normals, strict=True)}
    cosines = [
        float(normal @ lookup[tuple(np.rint(point * 100).astype(int))])
        for point, normal in zip(stored().points, stored().normals, strict=True)
    ]
    assert np.degrees(np.arccos(np.clip(min(cosines), -1, 1))) < 1.0


@pytest.mark.parametrize("position", [0, 4, 6, 20, 300, -20, -1])
def test_one_changed_byte_is_noticed(position: int) -> None:
    blob = bytearray(stored().to_blob())
    blob[position] ^= 0x10
    with pytest.raises(DataLoss):
        Place.from_blob(bytes(blob))


@pytest.mark.parametrize("length", [0, 3, 20, 1000])
def test_a_cut_blob_is_noticed(length: int) -> None:
    with pytest.raises(DataLoss):
        Place.from_blob(stored().to_blob()[:length])


def test_a_header_that_promises_more_than_the_body_holds_is_refused_even_with_a_valid_checksum() -> None:
    content = stored().to_blob()[:-16]
    changed = content.replace(b'"standing":', b'"standing":9', 1)
    head = int.from_bytes(changed[5:9], "little") + 1
    changed = changed[:5] + head.to_bytes(4, "little") + changed[9:]
    with pytest.raises(DataLoss, match="sections"):
        Place.from_blob(changed + hashlib.sha256(changed).digest()[:16])
