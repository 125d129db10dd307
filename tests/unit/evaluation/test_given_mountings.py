"""The mounting that a user gives for the clouds of a bag: used once, or not at all, and then it is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from revisit.core.errors import BadField
from revisit.core.geometry import se3
from revisit.evaluation.datasets import WantedTopics, notes_of, open_bag
from tests.support.bag_layouts import (
    MOUNTED,
    SCANS,
    Layout,
    alternating,
    body_at,
    deviation,
    kiss_icp,
    nuscenes_like,
    registered_only,
    tf_only,
)

pytest.importorskip("rosbags", reason="in the extra `dev`: writes the bags")

WRONG = MOUNTED @ se3.from_yaw(0.2, (0.0, 0.5, 0.0))


def said(recording) -> str:
    return " | ".join(notes_of(recording))


def body_alone() -> Layout:
    """Nothing leads from the body to the sensor."""
    return Layout().raw("/points", "laser", MOUNTED).transform("odom", "base_link", body_at, moving=True)


def moving_sensor() -> Layout:
    return Layout().raw("/points", "laser").transform("odom", "laser", body_at, moving=True)


@pytest.mark.parametrize("layout", [tf_only, nuscenes_like, kiss_icp])
def test_the_mounting_is_not_applied_on_top_of_that_of_the_transforms(tmp_path: Path, layout) -> None:
    recording = open_bag(layout().write2(tmp_path / "drive"), WantedTopics(T_body_sensor=MOUNTED))
    assert deviation(recording) < 1e-3
    assert "warning" not in said(recording)


@pytest.mark.parametrize("layout", [tf_only, nuscenes_like, kiss_icp])
def test_a_mounting_that_is_not_that_of_the_transforms_is_used_with_a_warning(tmp_path: Path, layout) -> None:
    recording = open_bag(layout().write2(tmp_path / "drive"), WantedTopics(T_body_sensor=WRONG))
    assert "warning: --T-body-sensor is used, though the transforms tell another mounting" in said(recording)
    assert "0.50 m and 11.5 degrees from it" in said(recording)
    assert deviation(recording) > 0.5


@pytest.mark.parametrize("odometry", [None, "/tf"])
def test_the_mounting_is_used_where_no_transform_leads_to_the_sensor(tmp_path: Path, odometry: str | None) -> None:
    recording = open_bag(body_alone().write2(tmp_path / "drive"), WantedTopics(None, odometry, MOUNTED))
    assert deviation(recording) < 1e-4
    assert "base_link is in odom, and --T-body-sensor how the sensor sits on base_link" in said(recording)


def test_without_the_mounting_the_advice_is_to_give_it(tmp_path: Path) -> None:
    with pytest.raises(BadField, match=r"base_link is in odom, but not where laser .*: say it with --T-body-sensor"):
        open_bag(body_alone().write2(tmp_path / "drive"))


def test_of_two_bodies_none_is_guessed(tmp_path: Path) -> None:
    bag = body_alone().transform("odom", "other", body_at, moving=True).write2(tmp_path / "drive")
    with pytest.raises(BadField, match="not on which of them laser of /points sits"):
        open_bag(bag, WantedTopics(T_body_sensor=MOUNTED))


def test_a_mounting_of_what_moves_by_itself_is_not_used_and_it_is_said(tmp_path: Path) -> None:
    recording = open_bag(moving_sensor().write2(tmp_path / "drive"), WantedTopics(T_body_sensor=MOUNTED))
    assert deviation(recording) < 1e-4
    assert "warning: --T-body-sensor is not used: the transforms lead to laser itself" in said(recording)


def test_a_mounting_on_poses_of_the_sensor_itself_is_warned_of(tmp_path: Path) -> None:
    bag = Layout().raw("/points", "laser").odometry("/odom", "odom", "laser").write2(tmp_path / "drive")
    assert "though the poses follow laser, the frame of the clouds" in said(
        open_bag(bag, WantedTopics(None, None, WRONG))
    )
    assert "warning" not in said(open_bag(bag, WantedTopics(T_body_sensor=np.eye(4))))


def test_clouds_in_the_frame_in_which_the_body_moves_stay_registered(tmp_path: Path) -> None:
    layout = registered_only().transform("odom", "body", body_at, moving=True)
    recording = open_bag(layout.write2(tmp_path / "drive"), WantedTopics(T_body_sensor=MOUNTED))
    assert "registered in odom" in said(recording)
    assert deviation(recording) < 1e-4


def test_clouds_of_a_frame_that_nothing_places_are_left_out_and_counted(tmp_path: Path) -> None:
    recording = open_bag(alternating(right_is_known=False).write2(tmp_path / "drive"))
    assert len(recording) == SCANS // 2 and deviation(recording) < 1e-4
    assert "warning: 4 of 8 clouds of /points are in another frame, right, and were left out" in said(recording)


def test_a_given_mounting_is_that_of_one_sensor(tmp_path: Path) -> None:
    recording = open_bag(alternating().write2(tmp_path / "drive"), WantedTopics(T_body_sensor=MOUNTED))
    assert len(recording) == SCANS // 2 and deviation(recording) < 1e-4
    assert "4 of 8 clouds of /points are in another frame, right" in said(recording)


def test_clouds_of_several_frames_come_in_the_order_of_their_times(tmp_path: Path) -> None:
    recording = open_bag(alternating().write2(tmp_path / "drive"))
    assert (np.diff(recording.stamps_ns) > 0).all()
    assert deviation(recording) < 1e-4


def test_the_transforms_alone_place_clouds_of_several_frames(tmp_path: Path) -> None:
    layout = alternating().transform("odom", "base_link", body_at, moving=True)
    recording = open_bag(layout.write2(tmp_path / "drive"), WantedTopics(odometry="/tf"))
    assert len(recording) == SCANS and deviation(recording) < 1e-3
