"""How the SDK encodes points."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.errors import BadField
from revisit.formats import NPY, QUANTISED, decode_cloud
from revisit.sdk import clouds
from revisit.sdk.clouds import Cloud, PointCloud, count_returns, encoded

POINTS = np.random.default_rng(1).uniform(-50, 50, (500, 3)).astype(np.float32)


def test_finite_points_travel_quantised_within_half_a_millimetre():
    cloud = encoded(POINTS)
    assert cloud.content_type == QUANTISED
    back = decode_cloud(cloud.data, cloud.content_type)
    np.testing.assert_allclose(back.points, POINTS, rtol=0, atol=0.00051)


def test_a_fourth_column_is_the_intensity():
    with_intensity = np.column_stack([POINTS, np.linspace(0, 1, 500, dtype=np.float32)])
    cloud = encoded(with_intensity)
    np.testing.assert_allclose(
        decode_cloud(cloud.data, cloud.content_type).columns["intensity"], with_intensity[:, 3], rtol=0, atol=1e-5
    )


def test_a_cloud_with_columns_travels_without_the_points_that_are_none():
    points, ring = POINTS.copy(), np.arange(500, dtype=np.uint16)
    points[3, 1] = np.nan
    cloud = encoded(PointCloud(points, {"ring": ring}))
    back = decode_cloud(cloud.data, cloud.content_type)
    np.testing.assert_array_equal(back.columns["ring"], np.delete(ring, 3))
    assert count_returns(PointCloud(points, {"ring": ring})) == 499
    with pytest.raises(BadField, match="ring must be 0 to 65,535"):
        encoded(PointCloud(POINTS, {"ring": ring - 1.0}))


@pytest.mark.parametrize("spoilt", [np.nan, np.inf, 20_000.0])
def test_what_cannot_be_quantised_goes_as_it_is_so_that_the_service_decides(spoilt):
    points = POINTS.copy()
    points[3, 1] = spoilt
    cloud = encoded(points)
    assert cloud.content_type == NPY
    np.testing.assert_array_equal(decode_cloud(cloud.data, cloud.content_type).points, points)


def test_encoded_clouds_pass_untouched_and_other_shapes_are_refused():
    cloud = Cloud(b"anything", "application/vnd.pcd")
    assert encoded(cloud) is cloud
    with pytest.raises(ValueError, match=r"\(n, 3\) or \(n, 4\)"):
        encoded(np.zeros((5, 2)))


@pytest.mark.parametrize("columns", [3, 4])
def test_finite_points_are_counted_whatever_the_intensity_says(columns):
    points = np.ones((9, columns), dtype=np.float32)
    assert count_returns(points) == 9
    points[2, 1], points[4, 0] = np.nan, np.inf
    assert count_returns(points) == 7
    points[:, -1] = np.nan
    assert count_returns(points) == (0 if columns == 3 else 7)
    points[:] = np.float32(3e38)  # their sum is more than a float32 can hold
    assert count_returns(points) == 9


def test_a_cloud_in_the_form_of_the_wire_is_counted_without_decoding_it(monkeypatch):
    cloud, far = encoded(POINTS), encoded(POINTS * np.float32(1000))
    assert (cloud.content_type, far.content_type) == (QUANTISED, NPY)
    assert count_returns(far) == len(POINTS)
    monkeypatch.setattr(clouds, "decode_cloud", None)
    assert count_returns(cloud) == len(POINTS)
    assert count_returns(Cloud(b"nonsense", QUANTISED)) == 0
