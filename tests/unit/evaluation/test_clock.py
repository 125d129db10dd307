"""Clocks that are set back while a bag is recorded: found, and told from messages that come out of order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.evaluation.datasets import findings_of, open_bag
from revisit.evaluation.datasets.clock import set_back
from revisit.evaluation.inspection import inspect_recording
from tests.support.bag_layouts import PERIOD_NS, START_NS, Layout, back_in_time, body_at, fast_lio

RISING = np.arange(40) * 100 + 1_000


def test_times_that_go_back_and_stay_are_found_where_they_do() -> None:
    stamps = RISING - np.where(np.arange(40) >= 20, 750, 0)
    found = set_back("/odom", stamps)
    assert found is not None
    assert (found.message, found.before_ns, found.after_ns, found.times) == (20, 2_900, 2_250, 1)


def test_each_run_is_counted() -> None:
    stamps = RISING - np.where(np.arange(40) >= 10, 750, 0) - np.where(np.arange(40) >= 30, 750, 0)
    found = set_back("/odom", stamps)
    assert found is not None and found.times == 2 and "and 1 times more" in str(found)


def test_messages_out_of_order_are_no_clock_that_was_set() -> None:
    swapped, sent_late, twice = RISING.copy(), np.insert(np.delete(RISING, 5), 12, RISING[5]), np.repeat(RISING, 2)
    swapped[1::2], swapped[::2] = RISING[::2], RISING[1::2]
    zero_once = np.where(np.arange(40) == 7, 0, RISING)
    for stamps in (RISING, swapped, sent_late, twice, zero_once, RISING[:1]):
        assert set_back("/odom", stamps) is None


def test_two_that_publish_on_one_topic_with_another_delay_are_no_clock_that_was_set() -> None:
    assert set_back("/odom", np.column_stack([RISING, RISING - 350]).ravel()) is None


@pytest.mark.parametrize("by_ns", [4 * PERIOD_NS, 9 * PERIOD_NS // 2, 3_600 * 10**9])
def test_the_inspection_of_a_bag_names_the_topic_and_the_time(tmp_path: Path, by_ns: int) -> None:
    pytest.importorskip("rosbags", reason="in the extra `dev`: writes the bags")
    layout = back_in_time(Layout().raw("/points", "lidar").odometry("/odom", "odom", "lidar"),
                          START_NS + 4 * PERIOD_NS, by_ns)  # fmt: skip
    recording = open_bag(layout.write2(tmp_path / "drive"))
    (finding,) = (one for one in inspect_recording(recording).findings if one.code == "time_goes_back")
    assert f"the stamps of /odom go back by {(by_ns - PERIOD_NS) / 1e9:.3f} s from 1700000000.363 s" in finding.measured
    assert (np.diff(recording.stamps_ns) >= 0).all()


def test_transforms_that_go_back_are_found_too(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="in the extra `dev`: writes the bags")
    layout = Layout().transform("odom", "lidar", body_at, moving=True)
    stamped = Layout(rows=[(at, topic, kind, message.transforms[0]) for at, topic, kind, message in layout.rows])
    message_of = layout.types["tf2_msgs/msg/TFMessage"]
    layout.rows = [
        (at, topic, kind, message_of(transforms=[transform]))
        for at, topic, kind, transform in back_in_time(stamped, START_NS + 4 * PERIOD_NS, 4 * PERIOD_NS).rows
    ]
    recording = open_bag(layout.raw("/points", "lidar").write2(tmp_path / "drive"))
    assert "the stamps of the transforms go back by 0.300 s" in findings_of(recording)[0].measured


def test_a_drive_whose_times_rise_has_no_such_finding(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="in the extra `dev`: writes the bags")
    layout = fast_lio().transform("camera_init", "body", lambda stamp: se3.from_yaw(0.1), moving=True)
    assert findings_of(open_bag(layout.write2(tmp_path / "drive"))) == ()
