"""The intensity of the returns goes with the points, and nothing rests on it."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.config import PipelineConfig, SubmapConfig
from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.core.scan import Scan, validate_intensity
from revisit.core.submap import Submap
from revisit.formats import QUANTISED, decode_cloud
from revisit.sdk.clouds import encoded
from revisit.service.adapters.core_recogniser import load_recogniser
from revisit.service.features.ingest.clouds import EncodedCloud, StoredCloud, accept_cloud, pack_cloud, unpack_cloud

COUNT = 3000


def street(seed: int) -> np.ndarray:
    """Ground and walls (n, 3) float32 as a sensor 1.7 m above the ground sees them."""
    rng = np.random.default_rng(seed)
    ground = np.column_stack([rng.uniform(-30, 30, (COUNT, 2)), np.full(COUNT, -1.7)])
    wall = np.column_stack([rng.uniform(-20, 20, COUNT), np.full(COUNT, 6.0), rng.uniform(-1.7, 4, COUNT)])
    return np.concatenate([ground, wall]).astype(np.float32)


def scans(*, bright: bool) -> list[Scan]:
    made = []
    for step in range(3):
        points = street(step)
        intensity = np.arange(len(points), dtype=np.float32) % 256 if bright else None
        made.append(Scan.validated(points, se3.from_yaw(0.1 * step, (2.0 * step, 0, 0)), 10**8 * step, intensity))
    return made


def test_points_that_are_dropped_take_their_intensity_with_them():
    points, intensity = street(0), np.arange(2 * COUNT, dtype=np.float32) % 256
    points[7] = np.nan
    scan = Scan.validated(points, np.eye(4), 0, intensity)
    np.testing.assert_array_equal(scan.intensity, np.delete(intensity, 7))


@pytest.mark.parametrize("wrong", [-1.0, 65_536.0, np.nan])
def test_an_intensity_that_cannot_be_used_costs_a_recording_no_scan(wrong):
    intensity = np.full(2 * COUNT, wrong, np.float32)
    assert Scan.validated(street(0), np.eye(4), 0, intensity).intensity is None
    with pytest.raises(BadField, match="intensity must be 0 to 65,535"):
        validate_intensity(intensity, street(0))


def test_a_column_of_zeros_tells_no_intensity():
    assert Scan.validated(street(0), np.eye(4), 0, np.zeros(2 * COUNT, np.float32)).intensity is None


def test_the_intensity_of_the_returns_that_stay_is_beside_their_points():
    config = SubmapConfig(min_range=5.0)
    dark = Submap.from_scans(scans(bright=False), config)
    submap = Submap.from_scans(scans(bright=True), config)
    np.testing.assert_array_equal(submap.points, dark.points)
    assert dark.intensity is None and len(submap.intensity) == len(submap.points) < 6 * COUNT
    first = scans(bright=True)[0]
    near = np.linalg.norm(first.points, axis=1) >= 5.0
    np.testing.assert_array_equal(submap.intensity[submap.scan_index == 0], first.intensity[near])


def test_a_scan_without_intensity_leaves_its_submap_without():
    mixed = [*scans(bright=True)[:2], *scans(bright=False)[2:]]
    assert Submap.from_scans(mixed, SubmapConfig()).intensity is None


def as_stored(scan: Scan) -> Scan:
    """The scan as the service has it: sent, decoded, packed and unpacked."""
    points = scan.points if scan.intensity is None else np.column_stack([scan.points, scan.intensity])
    sent = encoded(points)
    assert sent.content_type == QUANTISED
    stored: StoredCloud = unpack_cloud(pack_cloud(accept_cloud(EncodedCloud(sent.data, QUANTISED), 10_000)[0]))
    if scan.intensity is not None:
        np.testing.assert_allclose(stored.intensity, scan.intensity, atol=0.002)
        assert decode_cloud(sent.data, QUANTISED).intensity is not None
    return Scan.validated(stored.points, scan.T_odom_sensor, scan.stamp_ns, stored.intensity)


def test_a_place_is_described_bit_for_bit_alike_with_and_without_intensity():
    config, recogniser = PipelineConfig(), load_recogniser()
    described = []
    for bright in (True, False):
        stored = [as_stored(scan) for scan in scans(bright=bright)]
        described.append(recogniser.describe(Submap.from_scans(stored, config.submap), config))
    assert described[0].descriptor.tobytes() == described[1].descriptor.tobytes()
    assert (described[0].neural_map, described[0].place) == (described[1].neural_map, described[1].place)
