"""What accepted loops of a submap tell of its other candidates: a place to start, and when no comparison is needed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_row
from revisit.service.application.contract.map_frames import MapPose
from revisit.service.application.contract.recogniser import LoopVerdict
from revisit.service.application.contract.records import SubmapRecord
from revisit.service.application.recognise.told_poses import ToldPoses
from tests.support.records import a_submap

STRIDE_M = 5.0
DEFAULT = PipelineConfig()
CONFIG = replace(DEFAULT, loop=replace(DEFAULT.loop, enough=2))


def drive(station: int, session: int = 1) -> SubmapRecord:
    """A submap every 5 m along x by the odometry of a drive, which begins each drive at 0."""
    pose = se3.from_yaw(0.0, (STRIDE_M * station, 0.0, 0.0))
    position = tuple(float(value) for value in pose[:3, 3])
    number = 1000 * session + station
    return a_submap(
        f"{session}-{station}", station, session_number=session, number=number, T_odom_submap=pose_row(pose),
        position_m=position,
    )  # fmt: skip


def seen_at(x_m: float, station: int, y_m: float = 0.0, accepted: bool = True) -> LoopVerdict:
    """The verdict on station `station` of a query that stands at (x, y) in the odometry of that drive."""
    pose = se3.from_yaw(0.0, (x_m - STRIDE_M * station, y_m, 0.0))
    return LoopVerdict(accepted, None if accepted else "LOW_OVERLAP", 0.9, pose, {})


def told_by(*loops: tuple[SubmapRecord, LoopVerdict], config=CONFIG, in_map=()) -> ToldPoses:
    told = ToldPoses(config, lambda: dict(in_map))
    for match, verdict in loops:
        told.take_in(match, verdict)
    return told


def placed(x_m: float, frame: str = "frame-1") -> MapPose:
    return MapPose(pose_row(se3.from_yaw(0.0, (x_m, 0.0, 0.0))), frame, 1)


def test_one_loop_tells_where_the_next_submap_of_its_drive_lies_and_leaves_it_to_be_compared():
    told = told_by((drive(4), seen_at(22.0, 4))).of(drive(6))
    assert told is not None and told.within_reach and not told.is_known
    np.testing.assert_allclose(told.T_match_query, se3.from_yaw(0.0, (22.0 - 30.0, 0.0, 0.0)), atol=1e-12)


def test_a_rejected_candidate_tells_nothing():
    assert told_by((drive(4), seen_at(22.0, 4, accepted=False))).of(drive(5)) is None


def test_as_many_loops_as_are_enough_make_the_near_submaps_of_their_drive_known_and_hide_no_far_one():
    told = told_by((drive(4), seen_at(22.0, 4)), (drive(5), seen_at(22.1, 5)))
    near, far = told.of(drive(6)), told.of(drive(13))
    assert near is not None and (near.within_reach, near.is_known) == (True, True)
    assert far is not None and (far.within_reach, far.is_known) == (False, False)


def test_farther_than_odometry_carries_a_pose_nothing_is_told():
    told = told_by((drive(4), seen_at(22.0, 4)), (drive(5), seen_at(22.1, 5)))
    assert told.of(drive(5 + 13)) is None


@pytest.mark.parametrize("other", [seen_at(24.0, 5), seen_at(22.0, 5, y_m=1.5)], ids=["along", "aside"])
def test_loops_that_contradict_each_other_make_nothing_known(other):
    told = told_by((drive(4), seen_at(22.0, 4)), (drive(5), other)).of(drive(6))
    assert told is not None and not told.is_known


def test_nothing_is_left_out_where_all_candidates_are_wanted():
    every = replace(DEFAULT, loop=replace(DEFAULT.loop, enough=0))
    told = told_by((drive(4), seen_at(22.0, 4)), (drive(5), seen_at(22.0, 5)), config=every).of(drive(6))
    assert told is not None and told.within_reach and not told.is_known


IN_MAP = {drive(4).number: placed(20.0), drive(5).number: placed(25.0), drive(3, 2).number: placed(21.0),
          drive(11, 2).number: placed(61.0)}  # fmt: skip
"""Two drives in one frame of the map; the second one's odometry begins 6 m farther on."""


def test_by_the_map_a_submap_of_another_drive_is_known_where_it_is_near():
    told = told_by((drive(4), seen_at(22.0, 4)), (drive(5), seen_at(22.1, 5)), in_map=IN_MAP)
    near, far = told.of(drive(3, 2)), told.of(drive(11, 2))
    assert near is not None and near.is_known
    np.testing.assert_allclose(near.T_match_query[:3, 3], (1.0, 0.0, 0.0), atol=1e-12)
    assert far is not None and not far.within_reach and not far.is_known


def test_frames_of_the_map_that_nothing_joins_tell_nothing_of_each_other():
    apart = {**IN_MAP, drive(3, 2).number: placed(21.0, "frame-2")}
    told = told_by((drive(4), seen_at(22.0, 4)), (drive(5), seen_at(22.1, 5)), in_map=apart)
    assert told.of(drive(3, 2)) is None
