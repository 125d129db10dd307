"""Sessions whose anchors are not as they state, in words."""

from __future__ import annotations

import pytest

from revisit.cli.anchors import anchors_of_session


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"elsewhere": True}, "lie elsewhere, +0.2 m east, -1.0 m north, -47.0 m up: a wrong base station"),
        ({"sigma_factor": 40.2}, "err by 40 times their stated standard deviations"),
        ({}, "lie beside the map, +0.2 m east, -1.0 m north, -47.0 m up: another receiver"),
    ],
)
def test_anchors_of_a_session_that_are_not_as_they_state_are_told(told, words):
    one = {"session": "maps/m/sessions/s2", "offset_m": (0.2, -1.0, -47.0), "sigma_factor": 1.0, "elsewhere": False}
    said = anchors_of_session({**one, **told})
    assert "nchors of s2" in said and words in said
