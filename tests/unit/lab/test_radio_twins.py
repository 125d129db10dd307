"""The simulated radio of twins, and loops with and without it."""

from __future__ import annotations

import numpy as np
import pytest

from lab.radio_twins import PLAN, TWINS, access_points, run_round
from revisit.core.config import PipelineConfig
from revisit.core.radio import likeness


def test_radio_is_alike_on_a_storey_and_less_above_it():
    rng, alike = np.random.default_rng(0), []
    for seed in range(10):
        of = access_points(np.array(TWINS["storeys"]), seed)
        here = of.heard(np.array([20.0, 0.0, 1.6]), rng)
        others = [of.heard(np.array(at), rng) for at in ((22.0, 0.5, 1.6), (50.0, 0.0, 1.6), (22.0, 0.5, 5.6))]
        alike.append([likeness(here, one) or 0.0 for one in others])
    near, far, above = np.mean(alike, axis=0)
    assert near > 0.7 and far < 0.5 and above < 0.3


@pytest.mark.slow
def test_right_radio_gives_the_loops_of_twins_and_wrong_radio_no_false_one():
    counts = run_round(PLAN, "storeys", 1000, PipelineConfig())
    assert all(wrong == 0 for wrong, _ in counts.values())
    right = {name: right for name, (_, right) in counts.items()}
    assert right["radio"] >= 30 and right["20 % false"] >= 30
    assert right["replaced"] == right["of the other twin"] == right["none"] == 0
