"""The stored form of a place: small, exact after the first quantisation, strict."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial import cKDTree

from revisit.core import place as place_module
from revisit.core import place_second_form
from revisit.core.container import Container
from revisit.core.errors import DataLoss
from revisit.core.geometry import se3
from revisit.core.geometry.level_frame import LevelFrame
from revisit.core.kernels.octree_coder import ranks_of
from revisit.core.place import CONTAINER, Place
from revisit.core.place_keypoints import read_keypoints, write_keypoints
from revisit.core.place_surface import CORNER, read_surface, settled_surface, write_surface
from revisit.core.scan_disagreement import ScanDisagreement
from tests.support.old_places import SECOND_FORM, THIRD_FORM
from tests.support.yards import CONFIG, recognised, yard


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
    _, body = CONTAINER.unpack(blob)
    np.testing.assert_array_equal(np.frombuffer(body, "<f8", 12).reshape(3, 4), np.linalg.inv(frame.similarity)[:3])
    restored = Place.from_blob(blob).frame
    np.testing.assert_allclose(restored.similarity, frame.similarity, atol=1e-12)
    assert restored.scale == pytest.approx(0.25, rel=1e-12)


@pytest.mark.parametrize(
    "matrix", [np.zeros((3, 4)), np.diag([1.0, 2.0, 1.0, 0.0])[:3], 1e-200 * np.eye(3, 4), np.eye(2), "turned"]
)
def test_a_stored_frame_that_is_no_similarity_is_refused(matrix: object) -> None:
    of_second = {"keypoints": 0, "size": 0, "spacing": 0.8, "standing": 0, "ground": 0, "model": "m"}
    rows = matrix.tolist() if isinstance(matrix, np.ndarray) else matrix
    with pytest.raises(DataLoss, match="level frame"):
        Place.from_blob(place_second_form.CONTAINER.pack(of_second | {"T_level_submap": rows}, b""))
    if isinstance(matrix, np.ndarray) and matrix.shape == (3, 4):
        header, body = CONTAINER.unpack(stored().to_blob())
        with pytest.raises(DataLoss, match="level frame"):
            Place.from_blob(CONTAINER.pack(header, matrix.astype("<f8").tobytes() + body[96:]))


@pytest.mark.parametrize("stated", [[0.01], [0.01, -1.0], ["a", 0.1], [0.01] * 3, [0.01, float("inf")], 0.01])
def test_what_scans_disagree_by_survives_the_blob_and_nonsense_is_refused(stated: object) -> None:
    told = replace(stored(), scan_disagreement=ScanDisagreement(0.0123, 0.004, 0.01, 0.0008))
    assert Place.from_blob(told.to_blob()).scan_disagreement == told.scan_disagreement
    header, body = CONTAINER.unpack(told.to_blob())
    before = Place.from_blob(CONTAINER.pack({**header, "disagreement": [0.0123, 0.004]}, body))
    assert before.scan_disagreement == ScanDisagreement(0.0123, 0.004)
    with pytest.raises(DataLoss):
        Place.from_blob(CONTAINER.pack({**header, "disagreement": stated}, body))


def test_a_place_fits_into_9_kilobytes() -> None:
    assert len(stored().points) > 2000
    assert len(stored().to_blob()) <= 9_000


def test_a_stored_point_lies_within_two_centimetres_of_its_plane_and_faces_alike() -> None:
    surface = yard(1)
    gaps, rows = cKDTree(surface.vertices).query(stored().points)
    heights = np.einsum("ij,ij->i", stored().points - surface.vertices[rows], surface.normals[rows])
    facing = np.einsum("ij,ij->i", stored().normals, surface.normals[rows])
    assert np.percentile(gaps, 95) < 0.25
    assert np.percentile(np.abs(heights), 95) < 0.02
    assert np.degrees(np.arccos(np.clip(facing, -1, 1))).mean() < 6.0


def test_without_its_surface_a_place_has_the_same_keypoints() -> None:
    whole, keypoints = stored(), Place.from_blob(stored().to_blob(), surface=False)
    assert len(keypoints.points) == keypoints.standing_count == 0
    for name in ("keypoints", "orientations", "descriptors", "parity"):
        np.testing.assert_array_equal(getattr(keypoints, name), getattr(whole, name), err_msg=name)


@pytest.mark.parametrize("seed", range(3))
def test_any_surface_is_read_as_it_was_rounded(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-60, 60, (400, 3)) * (1, 1, 0.1)
    normals = rng.normal(size=(400, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    stream = write_surface(points.astype(np.float32), normals.astype(np.float32), 0.8, "standing")
    read, facing = read_surface(stream, 0.8, 400, "standing")
    assert write_surface(read, facing, 0.8, "standing") == stream
    settled = settled_surface(points.astype(np.float32), normals.astype(np.float32), 0.8, "standing")
    np.testing.assert_array_equal(settled, (read, facing))
    gaps, rows = cKDTree(read).query(points)
    assert gaps.max() < 0.8 and np.percentile(gaps, 95) < 0.3
    assert np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", facing[rows], normals), -1, 1)))[gaps < 0.2].mean() < 8.0


def test_a_surface_of_one_point_and_of_none_survive() -> None:
    up = np.array([[0.0, 0.0, 1.0]], dtype=np.float32)
    points, normals = read_surface(write_surface(-3.3 * up, up, 0.8, "standing"), 0.8, 10, "standing")
    np.testing.assert_allclose(points, [[0.0, 0.0, -3.3]], atol=0.02)
    np.testing.assert_allclose(normals, up)
    for kept in (up, up[:0]):
        read = read_surface(write_surface(kept, kept, 0.8, "ground"), 0.8, 10, "ground")
        np.testing.assert_array_equal(settled_surface(kept, kept, 0.8, "ground"), read)


def test_a_damaged_surface_is_refused_wherever_it_is_cut_or_changed() -> None:
    points = np.random.default_rng(1).uniform(-20, 20, (60, 3)).astype(np.float32)
    stream = write_surface(points, np.tile(np.float32([0, 0, 1]), (60, 1)), 0.8, "standing")
    for length in range(0, len(stream), 7):
        if length:
            with pytest.raises(DataLoss):
                read_surface(stream[:length], 0.8, 60, "standing")
    with pytest.raises(DataLoss):
        read_surface(stream, 0.8, 59, "standing")
    for position in range(0, len(stream), 3):
        changed = bytearray(stream)
        changed[position] ^= 0xFF
        with suppress(DataLoss):  # numbers of a place may be others; nothing else may happen
            read_surface(bytes(changed), 0.8, 60, "standing")


def first_form(keypoints: np.ndarray, levels: np.ndarray, centimetres: np.ndarray, standing: int) -> bytes:
    """A blob of the first form, by its description: keypoints (n, 2) and points (m, 3) in centimetres, facing up."""
    count, size, rows = len(keypoints), levels.shape[1], len(centimetres)
    differences = np.diff(centimetres, axis=0, prepend=np.zeros((1, 3), int)).astype("<i2")
    body = keypoints.T.astype("<i2").tobytes() + np.full(count, 16384, "<u2").tobytes()
    body += np.where(np.arange(size) % 2, -1, 1).astype(np.int8).tobytes() + levels.T.astype(np.int8).tobytes()
    body += differences.T.tobytes() + np.full(2 * rows, 127, np.uint8).tobytes()
    header = {"keypoints": count, "size": size, "points": rows, "standing": standing, "model": "m"}
    first = Container(b"RVPS\x01", "stored place", 9, 10**6, digest_bytes=16, body_length=True)
    return first.pack(header | {"T_level_submap": np.eye(4)[:3].tolist()}, body)


def test_a_place_of_the_first_form_is_read_and_can_be_compared_with_one_of_today() -> None:
    rng = np.random.default_rng(0)
    keypoints, points = rng.integers(-4000, 4000, (12, 2)), rng.integers(-3000, 3000, (50, 3))
    levels = rng.integers(-127, 128, (12, 64))
    old = Place.from_blob(first_form(keypoints, levels, points, 30))
    np.testing.assert_allclose(old.keypoints, 0.01 * keypoints, atol=1e-4)
    np.testing.assert_allclose(old.points, 0.01 * points, atol=1e-4)
    np.testing.assert_allclose(old.normals, np.tile([0.0, 0.0, 1.0], (50, 1)))
    np.testing.assert_allclose(old.orientations, np.pi / 4, rtol=1e-6)
    assert (old.standing_count, old.model, old.spacing) == (30, "m", CONFIG.verification.spacing)
    new = Place.from_blob(old.to_blob())
    np.testing.assert_array_equal(new.parity, old.parity)
    by_place = np.lexsort((old.keypoints[:, 0], old.keypoints[:, 1]))
    np.testing.assert_allclose(new.keypoints, old.keypoints[by_place], atol=0.051)
    likeness = old.descriptors[by_place] @ new.descriptors.T
    assert np.array_equal(likeness.argmax(axis=1), np.arange(12)) and np.diag(likeness).min() > 0.85


@pytest.mark.parametrize("surface", [True, False])
def test_a_place_of_the_second_form_is_read_and_written_again_in_the_form_of_today(surface: bool) -> None:
    old = Place.from_blob(SECOND_FORM, surface=surface)
    np.testing.assert_allclose(old.keypoints[0], [34.1, 17.5], atol=1e-5)
    np.testing.assert_array_equal(old.descriptors[3] > 0, [0, 0, 1, 0, 0, 1, 0, 1])
    assert (old.model, old.standing_count, len(old.points)) == (("m", 30, 40) if surface else ("m", 0, 0))
    if surface:
        assert old.content_digest.hex().startswith("330881bfb0e39fcf")
        np.testing.assert_allclose(old.points[:, 2], 0.3, atol=0.02)
        new = Place.from_blob(old.to_blob())
        np.testing.assert_array_equal(new.points, old.points)
        np.testing.assert_array_equal(new.normals, old.normals)


def test_what_the_form_of_today_wrote_once_is_read_for_good() -> None:
    read, second = Place.from_blob(THIRD_FORM), Place.from_blob(SECOND_FORM)
    np.testing.assert_array_equal(read.points, second.points)
    np.testing.assert_array_equal(read.normals, second.normals)
    assert read.to_blob() == THIRD_FORM


def test_of_too_many_cubes_those_of_least_rank_are_kept_evenly_over_the_surface() -> None:
    grid = np.stack(np.meshgrid(np.arange(60), np.arange(60), indexing="ij"), axis=-1).reshape(-1, 2)
    points = np.column_stack([0.8 * (grid - 30) + 0.4, np.zeros(len(grid))]).astype(np.float32)
    kept = place_module._spread_rows(points, np.ones(len(points), dtype=bool), 0.8, 1200)
    ranks = ranks_of(np.floor(points / 0.8 + CORNER).astype(np.int64))
    assert len(kept) == 1200 and np.array_equal(kept, np.sort(kept))
    assert ranks[kept].max() <= np.delete(ranks, kept).min()
    counts = np.histogram2d(*points[kept, :2].T, bins=10, range=[[-24, 24], [-24, 24]])[0]
    assert counts.min() >= 9 and counts.max() <= 15  # 12 of 36 each


@pytest.mark.parametrize("kept", [2500, 400, 1])
def test_bits_of_keypoints_are_read_as_written_and_a_damaged_string_is_refused_or_other_keypoints(kept: int) -> None:
    rng = np.random.default_rng(kept)
    cells, angles = rng.integers(-90, 90, (kept, 2)) * 4 + 2, rng.integers(0, 256, kept)
    bits = rng.random((kept, 20)) < np.linspace(0, 1, 20)
    string = write_keypoints(cells, angles, bits)
    rows = np.lexsort((cells[:, 0], cells[:, 1]))
    for read, written in zip(read_keypoints(string, kept, 20), (cells, angles, bits), strict=True):
        np.testing.assert_array_equal(read, written[rows])
    for position in range(0, len(string), 1 + len(string) // 60):
        changed = bytearray(string)
        changed[position] ^= 0xFF
        with pytest.raises(DataLoss):
            read_keypoints(string[:position], kept, 20)
        with suppress(DataLoss):
            read_keypoints(bytes(changed), kept, 20)


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
    changed = content.replace(b'"keypoints":', b'"keypoints":9', 1)
    head = int.from_bytes(changed[5:9], "little") + 1
    changed = changed[:5] + head.to_bytes(4, "little") + changed[9:]
    with pytest.raises(DataLoss, match="keypoints"):
        Place.from_blob(changed + hashlib.sha256(changed).digest()[:16])
