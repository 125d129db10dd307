"""LAZ files that laspy, which shares nothing with the writer but the decompressor, reads."""

from __future__ import annotations

import io

import laspy
import numpy as np
import pytest

from revisit.core.errors import BadField
from revisit.formats import laz


def test_another_reader_finds_every_point_to_half_a_millimetre():
    points = np.random.default_rng(0).uniform(-80.0, 80.0, (5000, 3)) + (4_000.0, -9_000.0, 110.0)
    found = laspy.read(io.BytesIO(laz.encode(points)))
    np.testing.assert_allclose(found.xyz, points, atol=0.00051)
    np.testing.assert_allclose(found.header.mins, found.xyz.min(axis=0), atol=1e-9)
    np.testing.assert_allclose(found.header.maxs, found.xyz.max(axis=0), atol=1e-9)
    assert found.header.are_points_compressed and found.header.point_count == 5000
    assert (np.asarray(found.return_number) == 1).all() and (np.asarray(found.number_of_returns) == 1).all()


@pytest.mark.parametrize(("span", "step"), [(1.0, 1 / 65535), (255.0, 1 / 257), (65535.0, 1.0)])
def test_intensity_is_a_share_of_the_range_of_the_sensor_in_16_bits(span, step):
    random = np.random.default_rng(0)
    points, intensity = random.uniform(-9.0, 9.0, (500, 3)), random.uniform(0.0, 1.0, 500).astype(np.float32) * span
    intensity[0] = span
    found = laspy.read(io.BytesIO(laz.encode(points, columns={"intensity": intensity})))
    np.testing.assert_allclose(found.intensity * step, intensity, atol=0.51 * step)
    assert not laspy.read(io.BytesIO(laz.encode(points))).intensity.any()


def test_the_reference_system_is_told_where_there_is_one():
    points = np.array([[500_000.0, 5_400_000.0, 110.0], [500_001.0, 5_400_002.0, 111.0]])
    keys = laspy.read(io.BytesIO(laz.encode(points, epsg=25832))).header.vlrs.get("GeoKeyDirectoryVlr")[0].geo_keys
    assert [(key.id, key.value_offset) for key in keys] == [(1024, 1), (3072, 25832)]
    assert not laspy.read(io.BytesIO(laz.encode(points))).header.vlrs.get("GeoKeyDirectoryVlr")


@pytest.mark.parametrize(
    ("points", "epsg"),
    [
        (np.zeros((0, 3)), None),
        (np.zeros((5, 2)), None),
        (np.array([[0.0, np.nan, 0.0]]), None),
        (np.array([[0.0, 0.0, 0.0], [9e6, 0.0, 0.0]]), None),
        (np.zeros((5, 3)), 5),
    ],
)
def test_what_a_laz_file_cannot_hold_is_refused(points, epsg):
    with pytest.raises(BadField):
        laz.encode(points, epsg)
