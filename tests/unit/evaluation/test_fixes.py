"""Fixes of satellites in bags of ROS 1 and 2, written by `rosbags`, become anchors of the drive."""

from __future__ import annotations

import numpy as np
import pytest
import typer

from revisit.cli.fixes import anchors_of
from revisit.core.geometry import geodesy
from revisit.evaluation.datasets import open_bag
from tests.support.bag_layouts import START_NS, Layout, body_at, scan_stamps

ORIGIN = (48.1, 11.5, 520.0)
COVARIANCE = np.array([[1.0, 0.2, 0.0], [0.2, 2.0, 0.0], [0.0, 0.0, 4.0]])


def at(stamp_ns: int) -> tuple[float, float, float]:
    return tuple(geodesy.geodetic_of_enu(ORIGIN, body_at(stamp_ns)[None, :3, 3])[0].tolist())


def drive(ros1: bool = False) -> Layout:
    return Layout(ros1=ros1).raw("/points", "base").odometry("/odom", "odom", "base")


def written(layout: Layout, folder):
    return layout.write1(folder / "drive.bag") if layout.ros1 else layout.write2(folder / "drive")


@pytest.mark.parametrize("ros1", [False, True])
def test_fixes_are_read_and_those_a_metre_apart_become_anchors(tmp_path, ros1):
    layout = drive(ros1).fixes("/gps/fix", at, covariance=COVARIANCE)
    recording = open_bag(written(layout, tmp_path))
    (fixes,) = recording.fixes.values()
    assert [one.stamp_ns for one in fixes] == scan_stamps()
    assert fixes[3].position == pytest.approx(at(scan_stamps()[3])) and fixes[3].frame == "gps"
    np.testing.assert_array_equal(fixes[0].covariance, COVARIANCE)
    first, second = anchors_of(recording, None, (0.1, 0.2, 0.3))
    assert (first.stamp_ns, first.anchor_id, first.kind) == (START_NS, f"gnss-{START_NS}", "GNSS")
    np.testing.assert_allclose(first.covariance_enu, COVARIANCE)
    np.testing.assert_allclose(first.T_odom_sensor, recording.pose(0), atol=1e-9)
    assert first.offset_m == (0.1, 0.2, 0.3) and first.geodetic == pytest.approx(at(START_NS))
    assert np.linalg.norm(second.T_odom_sensor[:3, 3] - first.T_odom_sensor[:3, 3]) >= 1.0


def test_a_receiver_without_a_fix_gives_none_and_one_without_a_covariance_an_assumed_one(tmp_path):
    layout = drive().fixes("/lost", at, status=-1).fixes("/rtk", at, status=2)
    recording = open_bag(written(layout, tmp_path))
    assert anchors_of(recording, "/lost", (0.0, 0.0, 0.0)) == []
    np.testing.assert_allclose(
        anchors_of(recording, "/rtk", (0.0, 0.0, 0.0))[0].covariance_enu, np.diag([0.25, 0.25, 1])
    )


def test_a_topic_that_is_not_there_is_refused_with_those_that_are(tmp_path, capsys):
    recording = open_bag(written(drive().fixes("/gps/fix", at), tmp_path))
    with pytest.raises(typer.Exit):
        anchors_of(recording, "/other", (0.0, 0.0, 0.0))
    assert "/gps/fix" in capsys.readouterr().err


def test_a_bag_without_fixes_has_no_anchors(tmp_path):
    assert anchors_of(open_bag(written(drive(), tmp_path)), None, (0.0, 0.0, 0.0)) == []
