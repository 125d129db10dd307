"""Errors of loops are held against what their covariances say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lab.loop_errors import (
    BOUND,
    ErrorRow,
    LoopError,
    draw,
    drawn_evenly,
    in_true_frames,
    loop_errors,
    near_pairs,
    table,
)
from revisit.core.geometry import se3
from revisit.evaluation.described_submaps import DescribedSubmap
from revisit.evaluation.loop_closure_method import Description
from tests.support.yards import CONFIG, moved, recognised, thinned, yard

COVARIANCE = np.diag(np.square([0.1, 0.1, 0.05, 0.01, 0.01, 0.02]))


def drawn(count: int, stated: float) -> list[LoopError]:
    """Errors as large as COVARIANCE says, stated as `stated` times their deviation."""
    errors = np.random.default_rng(3).normal(size=(count, 6)) * np.sqrt(np.diag(COVARIANCE))
    return [LoopError(0.45, 500, error, stated**2 * COVARIANCE) for error in errors]


def test_a_right_covariance_has_95_of_100_errors_within_the_bound_and_1_by_each_direction() -> None:
    row = ErrorRow.of(drawn(4_000, 1.0))
    assert row.median_nees == pytest.approx(5.35, abs=0.2)
    assert row.share_inside == pytest.approx(0.95, abs=0.01)
    np.testing.assert_allclose(row.by_direction, 1.0, atol=0.05)


def test_a_covariance_that_is_half_as_wide_as_the_errors_shows() -> None:
    row = ErrorRow.of(drawn(1_000, 0.5))
    assert row.median_nees > BOUND
    np.testing.assert_allclose(row.by_direction, 2.0, atol=0.1)
    assert table("yard", drawn(10, 1.0))[0].startswith("| yard | 0.4 to 0.5 | 10 |")


def submap(number: int, seed: int, T_world_submap: se3.Matrix4, yaw: float) -> DescribedSubmap:
    """A yard as seen from a pose, described after a turn."""
    T_turned_world = se3.from_yaw(yaw) @ se3.inverse(T_world_submap)
    place = recognised(thinned(moved(yard(seed), T_turned_world), 0.7, seed=number))[1]
    description = Description(np.zeros(1, np.float32), place.to_blob())
    position = T_world_submap[:3, 3]
    return DescribedSubmap(number, (100 * number,), position, T_world_submap, yaw, description, None, 1000)


def test_the_errors_of_turned_submaps_are_those_of_their_true_poses(tmp_path) -> None:
    first = submap(0, 1, np.eye(4), 0.4)
    second = submap(1, 1, se3.from_yaw(0.2, (3.0, 1.0, 0.0)), -1.3)
    far = replace(second, T_world_submap=se3.from_yaw(0.0, (90.0, 0.0, 0.0)))
    pairs = list(near_pairs([second, far], [first, second], apart_scans=30))
    assert [(query.id, match.id) for query, match in pairs] == [(1, 0)]
    (error,) = loop_errors(pairs, CONFIG.verification)
    assert np.linalg.norm(error.error[:3]) < 0.08
    assert error.nees < BOUND
    draw({"yards": [error]}, tmp_path / "nees.png")
    assert (tmp_path / "nees.png").stat().st_size > 5_000


def test_of_many_pairs_some_are_drawn_evenly_and_what_was_not_described_is_left_out() -> None:
    submaps = [
        replace(undescribed(number), description=Description(np.zeros(1, np.float32), b"")) for number in range(9)
    ]
    pairs = [(one, submaps[0]) for one in submaps]
    assert [query.id for query, _ in drawn_evenly([*pairs, (undescribed(9), submaps[0])], 5)] == [0, 2, 4, 6, 8]
    assert drawn_evenly(pairs, 9) == pairs


def test_the_true_frame_of_a_submap_is_that_of_its_middle_scan_on_the_exact_drive() -> None:
    class Exact:
        def pose(self, index: int) -> se3.Matrix4:
            return se3.from_yaw(0.0, (float(index), 0.0, 0.0))

    (found,) = in_true_frames([replace(undescribed(0), window=(4, 5, 7))], Exact())
    assert found.T_world_submap[0, 3] == 5.0


def undescribed(number: int) -> DescribedSubmap:
    """A submap that could not be described."""
    return DescribedSubmap(number, (number,), np.zeros(3), np.eye(4), 0.0, None, "why", 0)
