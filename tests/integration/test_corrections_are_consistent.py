"""Whether corrections are as sure as they say: errors of the poses, normalised by their covariances. Simulated."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from revisit.core.geometry import se3
from revisit.core.pose_graph.optimisation import optimise
from tests.support.made_up_fleet import Fleet, fleet

WITHIN = chi2.ppf(0.95, 6)


def squared_errors(made: Fleet) -> list[float]:
    """Of the last submap of each session that shares the frame, in its covariances, as seen from the frame's first."""
    found = optimise(made.graph)
    errors = []
    for group in found.components:
        first = made.graph.by_session[group[0]]
        T_map_world = first.T_odom_submap[0] @ se3.inverse(made.truth[first.session][0])
        for session in group:
            error = se3.log(se3.inverse(found.T_map_submap[session][-1]) @ T_map_world @ made.truth[session][-1])
            errors.append(float(error @ np.linalg.solve(found.covariances[session][-1], error)))
    return errors


def share_within(seeds: range, wrong_share: float) -> float:
    cases = [error for seed in seeds for error in squared_errors(fleet(seed, wrong_share, submaps=40, per_pair=10))]
    return float(np.mean(np.array(cases) < WITHIN))


def test_most_errors_of_corrections_are_within_what_their_covariances_say():
    assert share_within(range(6), 0.3) >= 0.8


@pytest.mark.slow
@pytest.mark.parametrize("wrong_share", [0.0, 0.3, 0.5])
def test_nine_of_ten_errors_of_corrections_are_within_chi_square_of_95_percent(wrong_share):
    share = share_within(range(100), wrong_share)
    print(f"wrong loops {wrong_share:.0%}: {share:.3f} of the errors within chi-square 95 %")
    assert share >= 0.9
