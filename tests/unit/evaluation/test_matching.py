"""What a verified candidate is worth."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.geometry import se3
from revisit.evaluation.matching import nearness


@pytest.mark.parametrize(("distance", "expected"), [(0.0, 1.0), (10.0, 16 / 17), (20.0, 0.5), (40.0, 1 / 17)])
def test_a_candidate_counts_less_the_farther_its_own_answer_puts_it(distance, expected):
    T_match_query = se3.from_yaw(1.0, (0.6 * distance, -0.8 * distance, 0.0))
    assert nearness(T_match_query, 20.0) == pytest.approx(expected)


def test_without_a_pose_nothing_is_known_of_the_distance():
    assert nearness(None, 20.0) == 1.0
    assert np.isfinite(nearness(np.eye(4), 1e-3))
