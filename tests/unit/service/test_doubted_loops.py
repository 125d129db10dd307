"""Doubted loops that are asked about a solution: those within its frames, where enough of them lie elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.service.features.graph.doubted_loops import contradicted, within_frames
from revisit.service.ports.map_optimiser import MapGraph, OptimisedMap, OptimisedTrack, SessionTrack, TrackLoop

STEPS = np.stack([se3.from_yaw(0.0, (5.0 * k, 0.0, 0.0)) for k in range(6)])


def solution(anchors: dict[int, int]) -> tuple[MapGraph, OptimisedMap]:
    """Sessions of six submaps each on one way, in frames of their own or not."""
    submaps = {number: tuple(range(10 * number, 10 * number + 6)) for number in anchors}
    tracks = tuple(SessionTrack(number, submaps[number], STEPS) for number in anchors)
    nowhere = np.zeros((6, 6, 6))
    solved = tuple(OptimisedTrack(number, anchor, np.eye(4), STEPS, nowhere) for number, anchor in anchors.items())
    return MapGraph(tracks, (), 10.0), OptimisedMap(solved, (), 0.0, 0)


def loops(aside_m: float, count: int = 6) -> list[TrackLoop]:
    """Between sessions 1 and 2, which the second lies aside by."""
    moved = se3.from_yaw(0.0, (0.0, aside_m, 0.0))
    return [TrackLoop(k, 10 + k, 20 + k, moved, None) for k in range(count)]


def test_loops_between_drives_that_surfaces_keep_apart_do_not_join_them_again() -> None:
    assert within_frames(*solution({1: 1, 2: 2}), loops(0.0)) == ()
    assert len(within_frames(*solution({1: 1, 2: 1}), loops(0.0))) == 6


def test_a_loop_of_a_submap_that_came_later_is_not_asked() -> None:
    assert within_frames(*solution({1: 1, 2: 1}), [TrackLoop(1, 16, 26, np.eye(4), None)]) == ()


@pytest.mark.parametrize(("aside_m", "count", "found"), [(0.5, 6, set()), (5.0, 4, set()), (5.0, 5, {1, 2})])
def test_sessions_are_asked_about_that_five_loops_say_to_lie_elsewhere(aside_m, count, found) -> None:
    assert contradicted(*solution({1: 1, 2: 1}), loops(aside_m, count)) == found
