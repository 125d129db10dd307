"""When the ROS 2 bridge begins a new session."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from revisit_bridge.session_rule import Begun, Continued, LastScan, Motion, Repeated, judge, new_session_id

from revisit.core.geometry import se3

SECOND = 10**9
LAST = LastScan("r-1", "boot a", "odom", "lidar", 100 * SECOND, se3.from_yaw(0.5, (40.0, 3.0, 0.0)))
MOTION = Motion(max_jump_m=5.0, max_speed_m_s=10.0, max_gap_s=10.0)


def later(seconds: float, moved_m: float = 0.5) -> LastScan:
    pose = LAST.T_odom_sensor.copy()
    pose[0, 3] += moved_m
    return replace(LAST, stamp_ns=LAST.stamp_ns + round(seconds * SECOND), T_odom_sensor=pose)


@pytest.mark.parametrize(
    ("scan", "expected"),
    [
        (later(0.1), Continued()),
        (later(3.0, 34.0), Continued()),  # the node was started again while the robot drove on
        (later(0.0), Repeated()),
        (later(-0.3), Repeated()),
    ],
)
def test_a_scan_that_fits_goes_on_with_the_session(scan, expected) -> None:
    assert judge(LAST, scan, MOTION) == expected


@pytest.mark.parametrize(
    ("scan", "reason"),
    [
        (replace(later(0.1), boot="boot b"), "machine was started anew"),
        (replace(later(0.1), odom_frame="map"), "frames are map and lidar"),
        (replace(later(0.1), sensor_frame="rear"), "frames are odom and rear"),
        (later(-50.0), "clock went back by 50.0 s"),
        (later(12.0, 0.0), "no scan for 12.0 s"),
        (later(0.1, -40.0), "jumped by 40.0 m in 0.10 s"),
    ],
)
def test_what_does_not_fit_begins_a_new_session_for_a_reason(scan, reason) -> None:
    verdict = judge(LAST, scan, MOTION)
    assert isinstance(verdict, Begun) and reason in verdict.reason


def test_the_first_scan_begins_a_session() -> None:
    assert isinstance(judge(None, LAST, MOTION), Begun)


def test_the_last_scan_outlives_the_process(tmp_path) -> None:
    LAST.save(tmp_path / "last.json")
    loaded = LastScan.load(tmp_path / "last.json")
    assert loaded is not None and np.allclose(loaded.T_odom_sensor, LAST.T_odom_sensor)
    assert replace(loaded, T_odom_sensor=LAST.T_odom_sensor) == LAST


@pytest.mark.parametrize("content", ["", "{}", "[1]", '{"session_id": "a"}', '{"T_odom_sensor": [[1, 2]]}'])
def test_a_damaged_file_is_as_none(tmp_path, content) -> None:
    (tmp_path / "last.json").write_text(content)
    assert LastScan.load(tmp_path / "last.json") is None
    assert LastScan.load(tmp_path / "no.json") is None


@pytest.mark.parametrize("robot", ["spot 7/ünit", "..", "r", "x" * 80])
def test_ids_are_such_that_the_service_takes_them_and_differ(robot) -> None:
    import re

    from revisit.service.domain.limits import ID_PATTERN

    drawn = {new_session_id(robot, set()) for _ in range(20)}
    assert all(re.fullmatch(ID_PATTERN, session_id) for session_id in drawn) and len(drawn) > 15
