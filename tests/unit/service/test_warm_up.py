"""Workers compile what they need before they take work, and take it even where the warmup fails."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

import numpy as np
import pytest

from revisit.core import kernels
from revisit.core.errors import EmptyCloud
from revisit.service import ONE_THREAD
from revisit.service.adapters.warmup import warm_up
from revisit.service.worker.supervisor import _environment
from tests.support.fake_recogniser import FakeRecogniser


class WarmedUp(FakeRecogniser):
    """Notes what it was asked."""

    def __init__(self, error=None):
        self.asked = []
        self._error = error

    def describe(self, submap, config):
        self.asked.append(("describe", submap))
        if self._error:
            raise self._error
        return super().describe(submap, config)

    def verify(self, query, match, similarity, config, initial=None):
        self.asked.append(("verify", query == match))


@pytest.fixture
def kernels_folder():
    """An open descriptor of the folder of the kernels."""
    folder = os.open(Path(kernels.__file__).parent, os.O_RDONLY)
    yield folder
    os.close(folder)


def test_the_warmup_describes_a_yard_with_walls_and_compares_equal_places_and_different_ones(kernels_folder):
    fcntl.flock(kernels_folder, fcntl.LOCK_SH)  # whoever warms up beside this test: the order is one and the same
    recogniser = WarmedUp()
    warm_up(recogniser)
    same, different, (_, submap) = recogniser.asked
    assert (same, different) == (("verify", True), ("verify", False))
    assert submap.scan_count == 3 and submap.T_odom_submap[2, 2] < 1.0
    standing = submap.points[submap.points[:, 2] > -1.2]
    assert len(standing) > 1000
    assert np.ptp(submap.points[:, :2], axis=0) == pytest.approx((40, 40), abs=1.0)


def test_a_yard_that_cannot_be_described_does_not_keep_a_worker_from_its_work():
    recogniser = WarmedUp(EmptyCloud())
    warm_up(recogniser)
    assert sorted(asked for asked, _ in recogniser.asked) == ["describe", "verify", "verify"]


def test_a_defect_of_the_method_is_not_hidden_by_the_warmup():
    with pytest.raises(RuntimeError):
        warm_up(WarmedUp(RuntimeError("a defect")))


def test_a_worker_gets_one_thread_for_each_library_and_finds_the_service(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "16")
    environment = _environment()
    assert {name: environment[name] for name in ONE_THREAD} == dict.fromkeys(ONE_THREAD, "1")
    assert "OPENCV_FOR_THREADS_NUM" in ONE_THREAD
    assert environment["PYTHONPATH"]
