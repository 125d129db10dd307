"""A loop that stands out from no other place is ambiguous, and supports no other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_row
from revisit.service.application.contract.recogniser import LoopVerdict
from revisit.service.application.recognise.look_alikes import not_standing_out, outdone_contacts
from revisit.service.application.recognise.loops_beside import Beside, contradicted, supported
from tests.support.records import a_submap

CONFIG = PipelineConfig()
QUERY = a_submap("q", 100, number=500, session_number=2)


def candidate(x_m: float, contrast: float, reason: str | None = "DEGENERATE_ALIGNMENT", score: float = 0.9) -> Beside:
    """A submap at `x_m` on its drive, and what comparing it with the query gave."""
    ordinal = int(x_m // 5)
    match = a_submap(f"m{ordinal}", ordinal, session_number=1, T_odom_submap=pose_row(se3.from_yaw(0.0, (x_m, 0, 0))))
    overlap = 0.6 if reason is None else 0.5
    evidence = {"measurement": {"overlap": overlap, "contrast": contrast}}
    return Beside(QUERY, match, 0.9, LoopVerdict(reason is None, reason, score, se3.from_yaw(0.0), evidence))


def explaining(
    overlap: float, x_m: float, reason: str | None = "AMBIGUOUS", *, session: int = 1, rival_x_m: float | None = None
) -> Beside:
    """A submap at `x_m` of a drive that explains so much of the query, and the pose of a rival, if there is one."""
    one = candidate(x_m, 0.2, reason)
    rivals = [] if rival_x_m is None else [se3.from_yaw(0.0, (rival_x_m - x_m, 0, 0)).tolist()]
    measured = {"overlap": overlap, "rivals": [{"overlap": overlap, "T_match_query": pose} for pose in rivals]}
    match = replace(one.match, session_number=session, number=1000 * session + one.match.ordinal)
    return replace(one, match=match, verdict=replace(one.verdict, evidence={"measurement": measured}))


def on_both_drives(x_m: float, evidence: dict[str, object], *, reason: str | None = None, off_m: float = 0.0) -> Beside:
    """A loop of submaps at `x_m` of either drive, `off_m` from where it should be."""
    number = int(x_m)
    ends = [
        a_submap(f"{name}{number}", int(x_m // 5), number=base + number, session_number=session,
                 T_odom_submap=pose_row(se3.from_yaw(0.0, (x_m, 0, 0))))
        for name, base, session in (("q", 5_000, 2), ("m", 1_000, 1))
    ]  # fmt: skip
    pose = se3.from_yaw(0.0, (off_m, 0, 0))
    return Beside(ends[0], ends[1], 0.9, LoopVerdict(reason is None, reason, 0.9, pose, evidence))


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


@pytest.mark.parametrize("session", [1, 7])
def test_a_loop_is_ambiguous_where_an_ambiguous_place_of_any_drive_explains_more(session: int) -> None:
    loop = explaining(0.35, 0.0, None)
    (changed,) = not_standing_out([loop, explaining(0.45, 80.0, session=session)], CONFIG)
    assert (changed.verdict.accepted, changed.verdict.reason) == (False, "AMBIGUOUS")
    told = changed.verdict.evidence["outdone"]
    assert (told["overlap"], told["elsewhere"]) == (0.35, 0.45)
    assert "explains 0.35 of the submap, and a place elsewhere 0.45" in told["words"]


@pytest.mark.parametrize("other", [
    explaining(0.34, 80.0),  # explains less
    explaining(0.45, 80.0, None),  # accepted itself: contradicting it is another rule's matter
    explaining(0.45, 80.0, "LOW_SCORE"),  # explains much, and was turned down for something else
    explaining(0.45, 8.0, rival_x_m=0.0),  # may say the same spot
])  # fmt: skip
def test_a_loop_is_not_outdone_by_others(other: Beside) -> None:
    changed = not_standing_out([explaining(0.35, 0.0, None), other], CONFIG)
    assert all(one.match.ordinal != 0 for one in changed)


@pytest.mark.parametrize(("reason", "outdone"), [("LOW_SCORE", 1), ("DEGENERATE_ALIGNMENT", 1), ("SEEN_THROUGH", 0)])
def test_where_two_drives_meet_first_any_place_elsewhere_that_was_aligned_counts(reason: str, outdone: int) -> None:
    met = [explaining(0.35, 0.0, None), explaining(0.45, 80.0, reason)]
    low = [met[0], replace(met[1], verdict=replace(met[1].verdict, score=0.1))]
    assert not_standing_out(low, CONFIG) == []
    assert len(outdone_contacts(low, [], CONFIG)) == outdone
    known_drive, other_drive = explaining(0.5, 30.0, None), explaining(0.5, 30.0, None, session=4)
    assert outdone_contacts(low, [known_drive], CONFIG) == []
    assert len(outdone_contacts(low, [other_drive], CONFIG)) == outdone


def test_the_best_candidate_of_a_spot_speaks_for_it() -> None:
    on = candidate(5.0, 0.2, None)
    there = replace(
        on,
        verdict=replace(
            on.verdict,
            T_match_query=se3.from_yaw(0.0, (-5.0, 0, 0)),
            evidence={"measurement": {"overlap": 0.6, "rivals": []}},
        ),
    )
    assert not_standing_out([explaining(0.35, 0.0, None), there, explaining(0.45, 80.0)], CONFIG) == []


@pytest.mark.parametrize(("doubt", "decided"), [(None, 1), ("look_alikes", 0), ("outdone", 0)])
def test_loops_that_do_not_stand_out_support_none(doubt: str | None, decided: int) -> None:
    reason, told = (None, {}) if doubt is None else ("AMBIGUOUS", {doubt: {}})
    sure = [on_both_drives(x_m, dict(told), reason=reason) for x_m in (0.0, 10.0, 20.0)]
    rival = {"overlap": 0.5, "T_match_query": se3.from_yaw(0.0, (8.0, 0, 0)).tolist()}
    open_one = on_both_drives(15.0, {"measurement": {"overlap": 0.5, "rivals": [rival]}}, reason="AMBIGUOUS")

    def register(query: object, match: object, similarity: float, near: np.ndarray) -> LoopVerdict:
        return LoopVerdict(True, None, 0.9, near, {})

    assert len(supported([*sure, open_one], CONFIG.verification, 5.0, register)) == decided


@pytest.mark.parametrize("doubt", ["look_alikes", "outdone"])
def test_loops_that_do_not_stand_out_contradict_others(doubt: str) -> None:
    loop = on_both_drives(10.0, {})
    others = [on_both_drives(x_m, {doubt: {}}, reason="AMBIGUOUS", off_m=30.0) for x_m in (5.0, 15.0)]
    (changed,) = contradicted([loop, *others], CONFIG.verification, 5.0)
    assert changed.key == loop.key and "contradicted" in changed.verdict.evidence
