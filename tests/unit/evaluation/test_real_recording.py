"""The real recording that REVISIT_DATA names, unpacked into a temporary folder."""

from __future__ import annotations

import numpy as np
import pytest

from lab.interleaved import evaluate_interleaved
from revisit.evaluation.datasets import KittiRecording
from revisit.evaluation.recording_evaluation import EvaluationOptions
from tests.support.real_data import needs_real_data, unpacked_drive

pytestmark = [pytest.mark.real_data, needs_real_data]
SCANS = 110


@pytest.fixture(scope="module")
def kitti00(tmp_path_factory: pytest.TempPathFactory) -> KittiRecording:
    return KittiRecording(unpacked_drive(tmp_path_factory.mktemp("real"), slice(SCANS)))


def test_the_real_drive_is_read_with_z_up_and_the_ground_below_the_sensor(kitti00: KittiRecording) -> None:
    assert len(kitti00) == SCANS
    positions = np.stack([kitti00.pose(index)[:3, 3] for index in range(len(kitti00))])
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    assert np.median(steps) == pytest.approx(1.8, abs=0.2) and np.ptp(positions[:, 2]) < 20.0
    scan = kitti00.scan(100)
    assert len(scan.points) > 100_000
    # KITTI's sensor rides 1.73 m above the road, and the road is the commonest surface.
    near = scan.points[np.linalg.norm(scan.points[:, :2], axis=1) < 10.0]
    heights, edges = np.histogram(near[:, 2], bins=np.arange(-3.0, 3.0, 0.1))
    assert edges[heights.argmax()] == pytest.approx(-1.7, abs=0.2)


@pytest.mark.slow
def test_turned_queries_of_a_real_street_find_their_places(kitti00: KittiRecording) -> None:
    first_part = _Head(kitti00, 90)
    options = EvaluationOptions(tau=10.0, stride=10.0, candidates=5, jobs=2)
    result = evaluate_interleaved(first_part, options, baselines=())
    assert result.queries >= 10
    assert result.verified_recall_at_1 >= 0.9 and result.accepted_false == 0


class _Head(KittiRecording):
    """The first scans of a recording."""

    def __init__(self, whole: KittiRecording, count: int) -> None:
        self.__dict__.update(whole.__dict__)
        self._files = self._files[:count]
