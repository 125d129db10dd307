"""Columns of the returns go with the points from a recording to the store, and no place rests on them."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.config import PipelineConfig, SubmapConfig
from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.core.point_columns import COLUMNS, at_rows, joined, same, validated
from revisit.core.scan import Scan
from revisit.core.submap import Submap
from revisit.formats import QUANTISED, quantised
from revisit.sdk.clouds import PointCloud, encoded
from revisit.service.adapters.core_recogniser import load_recogniser
from revisit.service.features.ingest.clouds import EncodedCloud, accept_cloud, pack_cloud, unpack_cloud

COUNT = 3000


def street(seed: int) -> np.ndarray:
    """Ground and walls (n, 3) float32 as a sensor 1.7 m above the ground sees them."""
    rng = np.random.default_rng(seed)
    ground = np.column_stack([rng.uniform(-30, 30, (COUNT, 2)), np.full(COUNT, -1.7)])
    wall = np.column_stack([rng.uniform(-20, 20, COUNT), np.full(COUNT, 6.0), rng.uniform(-1.7, 4, COUNT)])
    return np.concatenate([ground, wall]).astype(np.float32)


def told(count: int = 2 * COUNT) -> dict[str, np.ndarray]:
    """Every column of so many points, each with other values."""
    number = np.arange(count)
    return {
        "intensity": (number % 256).astype(np.float32),
        "ring": (number % 64).astype(np.uint16),
        "time": ((number - 1000) * 16_000).astype(np.int32),
        "rgb": np.column_stack([number % 251, number % 241, number % 239]).astype(np.uint8),
    }


def scans(*, bright: bool) -> list[Scan]:
    columns = told() if bright else {}
    return [
        Scan.validated(street(step), se3.from_yaw(0.1 * step, (2.0 * step, 0, 0)), 10**8 * step, columns)
        for step in range(3)
    ]


def test_points_that_are_dropped_take_their_columns_with_them():
    points = street(0)
    points[7] = np.nan
    scan = Scan.validated(points, np.eye(4), 0, told())
    assert tuple(scan.columns) == tuple(COLUMNS)
    assert same(scan.columns, at_rows(told(), np.delete(np.arange(2 * COUNT), 7)))


WRONG = {"intensity": (-1.0, 65_536.0, np.nan), "ring": (-1, 65_536, 3.5), "time": (-2e9 - 1, 0.5), "rgb": (-1, 256)}


@pytest.mark.parametrize(("name", "wrong"), [(name, one) for name, those in WRONG.items() for one in those])
def test_a_column_that_cannot_be_used_costs_a_recording_no_scan(name, wrong):
    columns = {**told(), name: told()[name].astype(np.float64)}
    columns[name][17] = wrong
    assert Scan.validated(street(0), np.eye(4), 0, columns).columns.keys() == told().keys() - {name}
    with pytest.raises(BadField, match=f"{name} must be .*[0-9]"):
        validated(columns, street(0))
    with pytest.raises(BadField, match=f"{name} must be .*got"):
        validated({name: told()[name][:-1]}, street(0))


@pytest.mark.parametrize("values", ["7", None, np.datetime64(0, "ns"), 1j], ids=["text", "object", "date", "complex"])
def test_a_column_of_no_numbers_is_refused_as_one_out_of_range(values):
    columns = {"time": np.full(2 * COUNT, values)}
    assert Scan.validated(street(0), np.eye(4), 0, columns).columns == {}
    with pytest.raises(BadField, match="time must be"):
        validated(columns, street(0))
    with pytest.raises(BadField, match="time must be"):
        quantised.encode(street(0), columns)


def test_a_column_of_zeros_tells_nothing():
    zeros = {name: np.zeros_like(values) for name, values in told().items()}
    assert Scan.validated(street(0), np.eye(4), 0, zeros).columns == {}


def test_a_column_that_is_not_known_is_refused_by_its_name():
    with pytest.raises(BadField, match="intensity, ring, time, rgb, not 'speed'"):
        validated({"speed": np.ones(2 * COUNT)}, street(0))


def test_the_columns_of_the_returns_that_stay_are_beside_their_points():
    config = SubmapConfig(min_range=5.0)
    dark, submap = (Submap.from_scans(scans(bright=bright), config) for bright in (False, True))
    np.testing.assert_array_equal(submap.points, dark.points)
    assert not dark.columns and len(submap.points) < 6 * COUNT
    first = scans(bright=True)[0]
    near = np.linalg.norm(first.points, axis=1) >= 5.0
    assert same(at_rows(submap.columns, submap.scan_index == 0), at_rows(first.columns, near))


def test_a_submap_has_the_columns_that_all_its_scans_have():
    ring = told()["ring"]
    mixed = [*scans(bright=True)[:2], Scan.validated(street(2), se3.from_yaw(0.2, (4, 0, 0)), 10**9, {"ring": ring})]
    assert tuple(Submap.from_scans(mixed, SubmapConfig()).columns) == ("ring",)
    assert joined([]) == {}


def as_stored(scan: Scan) -> Scan:
    """The scan as the service has it: sent, decoded, packed and unpacked."""
    sent = encoded(PointCloud(scan.points, scan.columns))
    assert sent.content_type == QUANTISED
    blob = pack_cloud(accept_cloud(EncodedCloud(sent.data, QUANTISED), 10_000)[0])
    stored = unpack_cloud(blob)
    assert stored.columns.keys() == scan.columns.keys()
    for name, values in scan.columns.items():
        np.testing.assert_allclose(stored.columns[name].astype(float), values, atol=0.002 if name == "intensity" else 0)
    assert not unpack_cloud(blob, ()).columns
    return Scan.validated(stored.points, scan.T_odom_sensor, scan.stamp_ns, stored.columns)


def test_a_place_is_described_bit_for_bit_alike_with_and_without_columns():
    config, recogniser = PipelineConfig(), load_recogniser()
    described = []
    for bright in (True, False):
        stored = [as_stored(scan) for scan in scans(bright=bright)]
        described.append(recogniser.describe(Submap.from_scans(stored, config.submap), config))
    assert described[0].descriptor.tobytes() == described[1].descriptor.tobytes()
    assert (described[0].neural_map, described[0].place) == (described[1].neural_map, described[1].place)
