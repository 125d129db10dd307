"""What accepted loops of a submap tell of its other candidates: a place to start, and when no comparison is needed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from revisit.core.acceptance import PredictedPoses, Station, StationInMap, verify_in_turn
from revisit.core.config import PipelineConfig
from revisit.core.verification import PairVerdict
from tests.support.claims import STRIDE_M, along_x
from tests.support.verdicts import rejected, verified

DEFAULT = PipelineConfig()
CONFIG = replace(DEFAULT, loop=replace(DEFAULT.loop, enough=2))

Named = tuple[int, int]
"""A submap by its number on its drive, and the drive."""


def seen_at(x_m: float, station: int, y_m: float = 0.0, accepted: bool = True) -> PairVerdict:
    """The verdict on station `station` of a query that stands at (x, y) in the odometry of that drive."""
    pose = along_x(x_m - STRIDE_M * station, y_m)
    return verified(pose) if accepted else rejected("LOW_OVERLAP", pose)


def drive(station: int, session: int = 1) -> Named:
    return station, session


class told_by:
    """What accepted pairs of a query predict; a submap every 5 m along x by the odometry of each drive, from 0 on."""

    def __init__(
        self, *loops: tuple[Named, PairVerdict], config=CONFIG, in_map: Mapping[Named, StationInMap] | None = None
    ) -> None:
        self._loops, self._config, self._in_map = loops, config, in_map or {}

    def of(self, asked: Named):
        named = [*(one for one, _ in self._loops), asked]
        stations = [Station(session, number, along_x(STRIDE_M * number)) for number, session in named]
        told = PredictedPoses(stations, self._config, lambda: [self._in_map.get(one) for one in named])
        for row, (_, verdict) in enumerate(self._loops):
            told.add(row, verdict)
        return told.of(len(self._loops))


def placed(x_m: float, frame: str = "frame-1") -> StationInMap:
    return StationInMap(frame, along_x(x_m))


def test_one_loop_tells_where_the_next_submap_of_its_drive_lies_and_leaves_it_to_be_compared():
    told = told_by((drive(4), seen_at(22.0, 4))).of(drive(6))
    assert told is not None and told.within_reach and not told.is_known
    np.testing.assert_allclose(told.T_match_query, along_x(22.0 - 30.0), atol=1e-12)


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


IN_MAP = {drive(4): placed(20.0), drive(5): placed(25.0), drive(3, 2): placed(21.0),
          drive(11, 2): placed(61.0)}  # fmt: skip
"""Two drives in one frame of the map; the second one's odometry begins 6 m farther on."""


def test_by_the_map_a_submap_of_another_drive_is_known_where_it_is_near():
    told = told_by((drive(4), seen_at(22.0, 4)), (drive(5), seen_at(22.1, 5)), in_map=IN_MAP)
    near, far = told.of(drive(3, 2)), told.of(drive(11, 2))
    assert near is not None and near.is_known
    np.testing.assert_allclose(near.T_match_query[:3, 3], (1.0, 0.0, 0.0), atol=1e-12)
    assert far is not None and not far.within_reach and not far.is_known


def test_frames_of_the_map_that_nothing_joins_tell_nothing_of_each_other():
    apart = {**IN_MAP, drive(3, 2): placed(21.0, "frame-2")}
    told = told_by((drive(4), seen_at(22.0, 4)), (drive(5), seen_at(22.1, 5)), in_map=apart)
    assert told.of(drive(3, 2)) is None


def test_candidates_are_verified_in_turn_from_what_the_others_predict_until_enough_agree():
    stations = [Station(1, number, along_x(STRIDE_M * number)) for number in (4, 5, 6, 7)]
    asked = []

    def verify(row: int, initial):
        asked.append((row, initial is not None))
        return seen_at(22.0, stations[row].ordinal)

    verdicts = verify_in_turn(PredictedPoses(stations, CONFIG), 4, verify)
    assert list(verdicts) == [0, 1] and asked == [(0, False), (1, True)]
    asked.clear()
    every = replace(DEFAULT, loop=replace(DEFAULT.loop, enough=0))
    assert list(verify_in_turn(PredictedPoses(stations, every), 4, verify)) == [0, 1, 2, 3]
    assert asked == [(0, False), (1, True), (2, True), (3, True)]
