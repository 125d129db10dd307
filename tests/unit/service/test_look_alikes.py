"""A loop that stands out from no other place of its drive is ambiguous."""

from __future__ import annotations

from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_row
from revisit.service.application.contract.recogniser import LoopVerdict
from revisit.service.application.recognise.look_alikes import not_standing_out
from revisit.service.application.recognise.loops_beside import Beside
from tests.support.records import a_submap

CONFIG = PipelineConfig()
QUERY = a_submap("q", 100, number=500, session_number=2)


def candidate(x_m: float, contrast: float, reason: str | None = "DEGENERATE_ALIGNMENT", score: float = 0.9) -> Beside:
    """A submap at `x_m` on its drive, and what comparing it with the query gave."""
    ordinal = int(x_m // 5)
    match = a_submap(f"m{ordinal}", ordinal, session_number=1, T_odom_submap=pose_row(se3.from_yaw(0.0, (x_m, 0, 0))))
    evidence = {"measurement": {"overlap": 0.5, "contrast": contrast}}
    return Beside(QUERY, match, 0.9, LoopVerdict(reason is None, reason, score, se3.from_yaw(0.0), evidence))


ACCEPTED = candidate(0.0, 0.09, None)
ROWS = [candidate(50.0 * place, 0.05) for place in range(1, 7)]


def test_a_loop_that_passes_where_every_other_place_nearly_does_is_ambiguous() -> None:
    (changed,) = not_standing_out([ACCEPTED, *ROWS], CONFIG)
    assert (changed.verdict.accepted, changed.verdict.reason) == (False, "AMBIGUOUS")
    assert changed.verdict.evidence["look_alikes"]["alike"] == 6
    assert "6 of 6 other places" in changed.verdict.evidence["look_alikes"]["words"]


def test_a_loop_stands_out_where_other_places_are_nothing_like_it() -> None:
    others = [candidate(50.0 * place, 0.0, "LOW_OVERLAP", score=0.0) for place in range(7, 10)]
    assert not_standing_out([ACCEPTED, *ROWS, *others], CONFIG) == []
    assert (
        not_standing_out([ACCEPTED, *[candidate(50.0 * place, 0.05, score=0.1) for place in range(1, 7)]], CONFIG) == []
    )


def test_the_street_before_and_behind_a_place_is_no_other_place_and_three_are_too_few_to_tell() -> None:
    assert not_standing_out([ACCEPTED, *[candidate(4.0 * place, 0.05) for place in range(1, 7)]], CONFIG) == []
    assert not_standing_out([ACCEPTED, *ROWS[:3]], CONFIG) == []
