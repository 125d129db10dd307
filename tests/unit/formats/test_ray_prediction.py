"""Quantised clouds: what is expected along rays, by exact integers beside the two forms that are computed."""

from __future__ import annotations

import struct

import numpy as np
import pytest
import zstandard

from revisit import formats
from revisit.core.errors import MalformedBody
from revisit.formats.quantised import MAGIC
from revisit.formats.ray_prediction import MAX_STEPS, Prediction

HEADER = struct.Struct("<4sIffBBH")


def plainly_decoded(columns: np.ndarray, of_side: int, of_height: int) -> np.ndarray:
    """Points (n, 3) in steps of what differs from what is expected (n, 3), word by word as the module says."""
    points, a1, b1, z1, a2, b2, z2 = [], 0, 0, 0, 0, 0, 0
    for da, db, dz in columns.tolist():
        x1, y1 = points[-1][:2] if points else (0, 0)
        x2, y2 = points[-2][:2] if len(points) > 1 else (0, 0)
        x_leads = abs(x1) >= abs(y1)
        (a1, b1), (a2, b2) = ((x1, y1), (x2, y2)) if x_leads else ((y1, x1), (y2, x2))
        a = a1 + da
        b = expected(of_side, a, (a1, b1), (a2, b2)) + db
        z = expected(of_height, a, (a1, z1), (a2, z2)) + dz
        points.append((a, b, z) if x_leads else (b, a, z))
        z1, z2 = z, z1
    return np.array(points, dtype=np.int64).reshape(-1, 3)


def expected(how: int, a: int, first: tuple[int, int], second: tuple[int, int]) -> int:
    (a1, c1), (a2, c2) = first, second
    if how == 0:
        return c1
    on_ray = c1 if a1 == 0 or abs(rounded(c1 * a, a1)) > 2**30 else rounded(c1 * a, a1)
    if how == 1 or a2 == 0 or abs(on_ray - rounded(c2 * a, a2)) > abs(a) // 16:
        return on_ray
    return 2 * on_ray - rounded(c2 * a, a2)


def rounded(n: int, m: int) -> int:
    n, m = (n, m) if m > 0 else (-n, -m)
    return (n + m // 2) // m


def encoded(columns: np.ndarray, of_side: int, of_height: int, rest: int = 0) -> bytes:
    """A cloud of steps of a metre that holds these differences."""
    coded = np.where(columns >= 0, 2 * columns, -2 * columns - 1).astype("<u4")
    planes = b"".join(column.copy().view(np.uint8).reshape(-1, 4).T.tobytes() for column in coded.T)
    head = HEADER.pack(MAGIC, len(columns), 1.0, 0.0, of_side, of_height, rest)
    return head + zstandard.ZstdCompressor().compress(planes)


def differences(kind: str, count: int = 3_000) -> np.ndarray:
    rng = np.random.default_rng(count)
    if kind == "near":  # many zeros, signs and changes of the leading axis
        return rng.integers(-2, 3, (count, 3))
    if kind == "far":
        size = 2.0 ** rng.uniform(0, 17, (count, 1))
        return (rng.normal(0, 1, (count, 3)) * size).astype(np.int64) * rng.choice([1, 0], (count, 3), p=[0.9, 0.1])
    turns = np.stack([rng.integers(-300, 300, count), rng.integers(-3, 4, count), rng.integers(-3, 4, count)], axis=1)
    turns[0] = (20_000, 300, -1_700)  # a ring
    return turns


@pytest.mark.parametrize("how", [(side, height) for side in Prediction for height in Prediction])
@pytest.mark.parametrize("kind", ["near", "far", "ring"])
def test_what_is_decoded_is_what_exact_integers_give(kind, how):
    columns = differences(kind)
    points = plainly_decoded(columns, *how)
    beyond = np.flatnonzero((np.abs(points) > MAX_STEPS).any(axis=1))
    count = beyond[0] if len(beyond) else len(points)
    assert count > 1_000 or kind == "far"
    found = formats.decode_cloud(encoded(columns[:count], *how), formats.QUANTISED)
    np.testing.assert_array_equal(found.points, points[:count].astype("f4"))


@pytest.mark.parametrize("kind", ["near", "far", "ring"])
def test_what_is_encoded_is_decoded(kind):
    points = np.clip(np.cumsum(differences(kind), axis=0), -9_999_000, 9_999_000) * 0.001
    data = formats.encode_quantised(points.astype("f4"))
    found = formats.decode_cloud(data, formats.QUANTISED).points
    np.testing.assert_allclose(found, points.astype("f4"), atol=0.00051, rtol=1e-7)


def test_rings_take_less_than_differences():
    rng = np.random.default_rng(5)
    azimuth = np.tile(np.linspace(0, 2 * np.pi, 2_000, endpoint=False), 8)
    elevation = np.repeat(np.radians(np.linspace(-15, 5, 8)), 2_000)
    range_m = 20 + 5 * np.cos(2 * azimuth) + rng.normal(0, 0.02, azimuth.shape)
    flat = range_m * np.cos(elevation)
    points = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), range_m * np.sin(elevation)], axis=1)
    data = formats.encode_quantised(points.astype("f4"))
    *_, of_side, of_height, _ = HEADER.unpack_from(data)
    assert (of_side, of_height) != (Prediction.DIFFERENCE, Prediction.DIFFERENCE)
    grid = np.rint(points * 1e3).astype(np.int64)
    plain = encoded(np.diff(grid, axis=0, prepend=0), 0, 0)
    assert len(data) < 0.7 * len(plain)


@pytest.mark.parametrize(("unit_m", "step_m"), [(0.01, 0.01), (0.5, 0.5), (5.0, 0.001)])
def test_points_on_a_coarser_grid_have_its_step(unit_m, step_m):
    points = (unit_m * np.random.default_rng(2).integers(-99, 99, (500, 3))).astype("f4")
    data = formats.encode_quantised(points)
    assert HEADER.unpack_from(data)[2] == np.float32(step_m)
    np.testing.assert_allclose(formats.decode_cloud(data, formats.QUANTISED).points, points, atol=1e-6)


def test_one_point_off_the_coarser_grid_keeps_its_millimetre():
    points = np.full((1_000, 3), 0.25, "f4")
    points[7, 1] = 0.251
    found = formats.decode_cloud(formats.encode_quantised(points), formats.QUANTISED).points
    np.testing.assert_allclose(found, points, atol=1e-6)


@pytest.mark.parametrize("data", [
    encoded(np.full((3, 3), 1), 3, 0),
    encoded(np.full((3, 3), 1), 0, 200),
    encoded(np.full((3, 3), 1), 0, 0, rest=1),
    encoded(np.full((3, 3), 1), 0, 0)[:18],
    encoded(np.full((3, 3), MAX_STEPS), 2, 2),
    encoded(np.array([[1, 1, 0], [2**24, 0, 0]]), 1, 1),
])  # fmt: skip
def test_what_cannot_be_is_refused(data):
    with pytest.raises(MalformedBody):
        formats.decode_cloud(data, formats.QUANTISED)


def test_any_bytes_are_decoded_or_refused():
    rng = np.random.default_rng(9)
    for _ in range(20):
        columns = rng.integers(-(2**31), 2**31, (50, 3)) >> rng.integers(0, 32, (50, 1))
        try:
            found = formats.decode_cloud(encoded(columns, *rng.integers(0, 3, 2)), formats.QUANTISED)
        except MalformedBody:
            continue
        assert np.abs(found.points).max() <= MAX_STEPS
