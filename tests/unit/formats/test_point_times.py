"""The times of points, as drivers of LiDARs write them."""

import numpy as np
import pytest

from revisit.formats.point_times import point_offsets
from revisit.formats.pointcloud2 import FieldType, PackedCloud, PointField

STAMP_NS = 1_700_000_000_123_456_789
TRUE_NS = np.linspace(0, 99_000_000, 200)
CODES = {FieldType.UINT32: "<u4", FieldType.FLOAT32: "<f4", FieldType.FLOAT64: "<f8", FieldType.UINT8: "u1"}


def packed(name: str, kind: FieldType, values: np.ndarray, offset: int = 12) -> PackedCloud:
    rows = np.zeros(len(values), np.dtype({"names": ["v"], "formats": [CODES[kind]], "offsets": [12], "itemsize": 24}))
    rows["v"] = values
    return PackedCloud((PointField(name, offset, kind),), 24, len(values), rows.tobytes())


DRIVERS = {
    "Ouster, uint32 nanoseconds since the stamp": ("t", FieldType.UINT32, TRUE_NS),
    "Livox, uint32 nanoseconds since the stamp": ("offset_time", FieldType.UINT32, TRUE_NS),
    "Livox, float64 nanoseconds since 1970": ("timestamp", FieldType.FLOAT64, STAMP_NS + TRUE_NS),
    "Velodyne, float32 seconds since the stamp": ("time", FieldType.FLOAT32, TRUE_NS / 1e9),
    "Hesai and RoboSense, float64 seconds since 1970": ("timestamp", FieldType.FLOAT64, (STAMP_NS + TRUE_NS) / 1e9),
    "milliseconds": ("time", FieldType.FLOAT32, TRUE_NS / 1e6),
    "microseconds": ("time", FieldType.FLOAT32, TRUE_NS / 1e3),
}


@pytest.mark.parametrize("driver", DRIVERS)
def test_times_are_nanoseconds_since_the_stamp(driver):
    found = point_offsets(packed(*DRIVERS[driver]), STAMP_NS)
    assert found is not None and np.abs(found - TRUE_NS).max() < 1_000


def test_times_before_the_stamp_are_negative():
    found = point_offsets(packed("time", FieldType.FLOAT32, (TRUE_NS - TRUE_NS[-1]) / 1e9), STAMP_NS)
    assert found is not None and np.abs(found - (TRUE_NS - TRUE_NS[-1])).max() < 1_000


def test_a_point_without_a_time_has_that_of_the_stamp():
    values = (STAMP_NS + TRUE_NS) / 1e9
    values[7], values[8] = 0.0, np.nan
    found = point_offsets(packed("timestamp", FieldType.FLOAT64, values), STAMP_NS)
    assert found is not None and found[7] == found[8] == 0 and found[-1] > 9e7


NONE = {
    "no such field": packed("intensity", FieldType.FLOAT32, TRUE_NS / 1e9),
    "all one time": packed("t", FieldType.UINT32, np.full(200, 5e7)),
    "longer than a sweep": packed("t", FieldType.UINT32, TRUE_NS * 30),
    "another clock": packed("timestamp", FieldType.FLOAT64, 5e5 + TRUE_NS / 1e9),
    "an unknown type": packed("t", FieldType.UINT32, TRUE_NS).__class__(
        (PointField("t", 12, 99),), 24, 200, bytes(24 * 200)
    ),
    "outside of the point": packed("t", FieldType.UINT32, TRUE_NS, offset=22),
    "no points": packed("t", FieldType.UINT32, np.zeros(0)),
}


@pytest.mark.parametrize("case", NONE)
def test_what_cannot_be_the_times_of_a_sweep_is_not_believed(case):
    assert point_offsets(NONE[case], STAMP_NS) is None
