"""The stored form of a place: small, exact after the first quantisation, strict."""

from __future__ import annotations

import hashlib
import struct
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from revisit.core.codec.place import DIGEST_BYTES, MAGIC
from revisit.core.codec.place_head import pack_head, unpack_head
from revisit.core.codec.place_keypoints import read_keypoints, write_keypoints
from revisit.core.codec.place_surface import CORNER, read_surface, settled_surface, write_surface
from revisit.core.errors import DataLoss, FormerForm
from revisit.core.geometry import se3
from revisit.core.geometry.level_frame import LevelFrame
from revisit.core.kernels.octree_coder import ranks_of
from revisit.core.place import Place
from revisit.core.place import extraction as place_module
from revisit.core.scan_disagreement import ScanDisagreement
from tests.support.stored_place import STORED_PLACE
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


@pytest.mark.parametrize("scale", [1.0, 0.25])
def test_a_place_as_it_is_stored_is_known_without_reading_it(scale: float) -> None:
    described = replace(stored(), frame=LevelFrame.from_upright(se3.exp([1.0, 2.0, 3.0, 0.1, -0.2, 0.05]), scale))
    blob = described.to_blob()
    known, read = described.as_stored(blob), Place.from_blob(blob)
    for name in ("keypoints", "orientations", "descriptors", "parity", "points", "normals"):
        one, other = getattr(known, name), getattr(read, name)
        assert one.tobytes() == other.tobytes() and (one.dtype, one.strides) == (other.dtype, other.strides), name
    assert known.frame.rotation.tobytes() == read.frame.rotation.tobytes()
    assert (known.frame.scale, known.spacing, known.model) == (read.frame.scale, read.spacing, read.model)
    assert known.scan_disagreement == read.scan_disagreement and known.standing_count == read.standing_count


@pytest.mark.parametrize(
    "motion", [[0, 0, 0, 0, 0, 0], [1.0, 2.0, 3.0, 0.1, -0.2, 0.05], [-5e5, 0, 7, 0, 0, 3.1], [0, 0, 0, 0, 3.14159, 0]]
)
@pytest.mark.parametrize("scale", [1.0, 0.25])
def test_the_stored_frame_returns_within_rounding(motion: list[float], scale: float) -> None:
    frame = LevelFrame.from_upright(se3.exp(motion), scale)
    blob = replace(stored(), frame=frame).to_blob()
    restored = Place.from_blob(blob).frame
    np.testing.assert_allclose(restored.rotation, frame.rotation, atol=6e-14)
    np.testing.assert_array_equal(restored.translation, frame.translation)
    assert restored.scale == frame.scale
    assert replace(stored(), frame=restored).to_blob() == blob


@pytest.mark.parametrize(
    "unusable",
    [{"scale": 1e-7}, {"scale": 1e9}, {"translation": np.array([0.0, 0.0, np.inf])}],
    ids=["small", "large", "far"],
)
def test_a_stored_frame_that_is_no_similarity_is_refused(unusable: dict[str, Any]) -> None:
    frame = LevelFrame()
    for name, value in unusable.items():
        object.__setattr__(frame, name, value)
    with pytest.raises(DataLoss, match="level frame"):
        Place.from_blob(replace(stored(), frame=frame).to_blob())


@pytest.mark.parametrize("model", ["0123456789abcdef", "0123456789ABCDEF", "", "m\u00fc", "x" * 255])
def test_the_name_of_the_model_survives(model: str) -> None:
    assert Place.from_blob(replace(stored(), model=model).to_blob()).model == model


@pytest.mark.parametrize("told", [(0.0123, 0.004, 0.01, 0.0008), (0.65536, 0.0, 1.5, 0.2), (1 / 3, 0.0, 0.0, 0.0)])
def test_what_scans_disagree_by_survives_the_blob(told: tuple[float, float, float, float]) -> None:
    disagreement = ScanDisagreement(*told)
    assert (
        Place.from_blob(replace(stored(), scan_disagreement=disagreement).to_blob()).scan_disagreement == disagreement
    )


@pytest.mark.parametrize("told", [(-1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, float("nan")), (0.0, 1e400, 0.0, 0.0)])
def test_scans_that_disagree_by_nonsense_are_refused(told: tuple[float, float, float, float]) -> None:
    good = replace(stored(), scan_disagreement=ScanDisagreement(1 / 3, 0.0, 0.0, 0.0)).to_blob()
    head, length = unpack_head(good[len(MAGIC) :])
    ends = len(MAGIC) + length
    assert pack_head(head) == good[len(MAGIC) : ends]
    changed = good[: ends - 32] + struct.pack("<4d", *told) + good[ends:-DIGEST_BYTES]
    with pytest.raises(DataLoss, match="disagreement"):
        Place.from_blob(changed + hashlib.sha256(changed).digest()[:DIGEST_BYTES])


def test_a_place_fits_into_8_kilobytes() -> None:
    assert len(stored().points) > 2000
    assert len(stored().to_blob()) <= 8_000


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


def test_a_place_that_was_written_once_is_read_for_good() -> None:
    read = Place.from_blob(STORED_PLACE)
    np.testing.assert_allclose(read.keypoints[2], [34.1, 17.5], atol=1e-5)
    np.testing.assert_array_equal(read.descriptors[1] > 0, [0, 0, 1, 0, 0, 1, 0, 1])
    np.testing.assert_allclose(read.points[:, 2], 0.3, atol=0.02)
    assert (read.model, read.standing_count, len(read.points)) == ("m", 30, 40)
    assert read.content_digest.hex().startswith("3e4c5b2716041c7f")
    assert read.to_blob() == STORED_PLACE


@pytest.mark.parametrize("surface", [True, False])
@pytest.mark.parametrize("version", [1, 2, 3])
def test_a_place_of_a_former_form_is_refused_with_the_command_that_mends_it(version: int, surface: bool) -> None:
    with pytest.raises(FormerForm, match=r"stored place.*revisit reembed MAP"):
        Place.from_blob(b"RVPS" + bytes([version]) + STORED_PLACE[5:], surface=surface)


def test_of_too_many_cubes_those_of_least_rank_are_kept_evenly_over_the_surface() -> None:
    grid = np.stack(np.meshgrid(np.arange(60), np.arange(60), indexing="ij"), axis=-1).reshape(-1, 2)
    points = np.column_stack([0.8 * (grid - 30) + 0.4, np.zeros(len(grid))]).astype(np.float32)
    kept = place_module._spread_rows(points, np.ones(len(points), dtype=bool), 0.8, 1200)
    ranks = ranks_of(np.floor(points / 0.8 + CORNER).astype(np.int64))
    assert len(kept) == 1200 and np.array_equal(kept, np.sort(kept))
    assert ranks[kept].max() <= np.delete(ranks, kept).min()
    counts = np.histogram2d(*points[kept, :2].T, bins=10, range=[[-24, 24], [-24, 24]])[0]
    assert counts.min() >= 9 and counts.max() <= 15  # 12 of 36 each


def made_up_keypoints(kept: int, turns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cells, angles of so many directions, and bits of descriptors, some columns nearly always alike."""
    rng = np.random.default_rng(kept)
    cells, angles = rng.integers(-90, 90, (kept, 2)) * 4 + 2, rng.integers(0, turns, kept)
    return cells, angles, rng.random((kept, 20)) < np.linspace(0, 1, 20)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("turns", [256, 3])
@pytest.mark.parametrize("kept", [400, 2, 1])
def test_keypoints_are_read_as_written_with_and_without_compiled_code(kept: int, turns: int, compiled: bool) -> None:
    cells, angles, bits = made_up_keypoints(kept, turns)
    string = write_keypoints(cells, angles, bits)
    rows = np.lexsort((cells[:, 0], cells[:, 1]))
    for read, written in zip(read_keypoints(string, kept, 10, compiled=compiled), (cells, angles, bits), strict=True):
        np.testing.assert_array_equal(read, written[rows])


@pytest.mark.parametrize("compiled", [True, False])
def test_keypoints_as_far_apart_as_can_be_written_are_read_as_written(compiled: bool) -> None:
    cells = np.array([[-32767, -32767], [32767, -32767], [0, -32766], [-32767, 32767], [32767, 32767]])
    angles, bits = np.array([0, 255, 128, 127, 1]), np.eye(5, 64, dtype=bool)
    read = read_keypoints(write_keypoints(cells, angles, bits), 5, 32, compiled=compiled)
    for part, written in zip(read, (cells, angles, bits), strict=True):
        np.testing.assert_array_equal(part, written)


def keypoints_or_refusal(data: bytes, kept: int, compiled: bool) -> list[list[int]] | str:
    """What a string of keypoints is read as."""
    try:
        return [part.tolist() for part in read_keypoints(data, kept, 10, compiled=compiled)]
    except DataLoss as refusal:
        return str(refusal)


def test_a_damaged_string_of_keypoints_is_refused_or_other_keypoints_the_same_without_compiled_code() -> None:
    string = write_keypoints(*made_up_keypoints(60, 5))
    for length in range(0, len(string), 9):
        with pytest.raises(DataLoss):
            read_keypoints(string[:length], 60, 10)
    outcomes = set()
    for position in range(0, len(string), 2):
        changed = bytearray(string)
        changed[position] ^= 0xFF
        read = keypoints_or_refusal(bytes(changed), 60, True)
        assert keypoints_or_refusal(bytes(changed), 60, False) == read
        outcomes.add(type(read))
    assert outcomes == {list, str}
    for count in (0, 59, 61):
        with pytest.raises(DataLoss):
            read_keypoints(string, count, 10)
    assert [len(part) for part in read_keypoints(b"", 0, 10)] == [0, 0, 0]


def test_keypoints_that_take_more_bytes_than_expected_are_written_whole() -> None:
    cells, angles, _ = made_up_keypoints(600, 256)
    bits = np.random.default_rng(1).random((600, 64)) < 0.5
    string = write_keypoints(cells, angles, bits)
    assert len(string) > 256 + 8 * 600
    rows = np.lexsort((cells[:, 0], cells[:, 1]))
    np.testing.assert_array_equal(read_keypoints(string, 600, 32)[2], bits[rows])


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


@pytest.mark.parametrize(
    "promised",
    [{"keypoints": 10**6}, {"keypoints": 199}, {"numbers": 33}, {"keypoint_bytes": 10**6}, {"standing_bytes": 2**31},
     {"spacing": float("nan")}, {"spacing": 1e4}],
)  # fmt: skip
def test_a_head_that_promises_what_the_body_does_not_hold_is_refused_even_with_a_valid_checksum(
    promised: dict[str, Any],
) -> None:
    content = stored().to_blob()[:-DIGEST_BYTES]
    head, length = unpack_head(content[len(MAGIC) :])
    changed = MAGIC + pack_head(replace(head, **promised)) + content[len(MAGIC) + length :]
    with pytest.raises(DataLoss):
        Place.from_blob(changed + hashlib.sha256(changed).digest()[:DIGEST_BYTES])
