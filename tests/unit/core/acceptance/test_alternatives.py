"""A loop that stands out from no other place is ambiguous, and supports no other."""

from __future__ import annotations

import numpy as np
import pytest

from revisit.core.acceptance import Doubt, LoopClaim, Station, StationInMap, accept_cloud
from revisit.core.acceptance.alternatives import not_standing_out, outdone_contacts, without_twins
from revisit.core.acceptance.consistency import inconsistent
from revisit.core.acceptance.support import with_support
from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.verification import InitialPose, PairVerdict
from tests.support.claims import along_x, at, doubted, pair
from tests.support.verdicts import verified

CONFIG = PipelineConfig()
QUERY = at(500.0, 2)


def candidate(
    x_m: float, contrast: float, reason: str | None = "DEGENERATE_ALIGNMENT", score: float = 0.9
) -> LoopClaim:
    """A submap at `x_m` on its drive, and what comparing it with the query gave."""
    return pair(
        QUERY, at(x_m), [se3.from_yaw(0.0)], reason, score, overlap=0.6 if reason is None else 0.5, contrast=contrast
    )


def explaining(
    overlap: float, x_m: float, reason: str | None = "AMBIGUOUS", *, drive: int = 1, rival_x_m: float | None = None,
    score: float = 0.9,
) -> LoopClaim:  # fmt: skip
    """A submap at `x_m` of a drive that explains so much of the query, and the pose of a rival, if there is one."""
    rivals = [] if rival_x_m is None else [along_x(rival_x_m - x_m)]
    return pair(QUERY, at(x_m, drive), [along_x(0.0), *rivals], reason, score, overlap=overlap)


def on_both_drives(x_m: float, *, off_m: float = 0.0) -> LoopClaim:
    """A loop of submaps at `x_m` of either drive, `off_m` from where it should be."""
    return pair(at(x_m, 2), at(x_m, 1), [along_x(off_m)])


ACCEPTED = candidate(0.0, 0.09, None)
ROWS = [candidate(50.0 * place, 0.05) for place in range(1, 7)]


def test_a_loop_that_passes_where_every_other_place_nearly_does_is_ambiguous() -> None:
    changed = not_standing_out([ACCEPTED, *ROWS], CONFIG)
    assert changed.keys() == {0} and (changed[0].accepted, changed[0].reason) == (False, "AMBIGUOUS")
    grounds = changed[0].doubts[Doubt.PERCEPTUAL_ALIAS]
    assert grounds.figures["alike"] == 6 and "6 of 6 other places" in grounds.words


def test_a_loop_stands_out_where_other_places_are_nothing_like_it() -> None:
    others = [candidate(50.0 * place, 0.0, "LOW_OVERLAP", score=0.0) for place in range(7, 10)]
    assert not_standing_out([ACCEPTED, *ROWS, *others], CONFIG) == {}
    assert (
        not_standing_out([ACCEPTED, *[candidate(50.0 * place, 0.05, score=0.1) for place in range(1, 7)]], CONFIG) == {}
    )


def test_the_street_before_and_behind_a_place_is_no_other_place_and_three_are_too_few_to_tell() -> None:
    assert not_standing_out([ACCEPTED, *[candidate(4.0 * place, 0.05) for place in range(1, 7)]], CONFIG) == {}
    assert not_standing_out([ACCEPTED, *ROWS[:3]], CONFIG) == {}


@pytest.mark.parametrize("drive", [1, 7])
def test_a_loop_is_ambiguous_where_an_ambiguous_place_of_any_drive_explains_more(drive: int) -> None:
    loop = explaining(0.35, 0.0, None)
    changed = not_standing_out([loop, explaining(0.45, 80.0, drive=drive)], CONFIG)
    assert changed.keys() == {0} and (changed[0].accepted, changed[0].reason) == (False, "AMBIGUOUS")
    grounds = changed[0].doubts[Doubt.BETTER_ALTERNATIVE]
    assert grounds.figures == {"overlap": 0.35, "elsewhere": 0.45}
    assert "explains 0.35 of the submap, and a place elsewhere 0.45" in grounds.words


@pytest.mark.parametrize("other", [
    explaining(0.34, 80.0),  # explains less
    explaining(0.45, 80.0, None),  # accepted itself: contradicting it is another rule's matter
    explaining(0.45, 80.0, "LOW_SCORE"),  # explains much, and was turned down for something else
    explaining(0.45, 8.0, rival_x_m=0.0),  # may say the same spot
])  # fmt: skip
def test_a_loop_is_not_outdone_by_others(other: LoopClaim) -> None:
    assert 0 not in not_standing_out([explaining(0.35, 0.0, None), other], CONFIG)


@pytest.mark.parametrize(("reason", "outdone"), [("LOW_SCORE", 1), ("DEGENERATE_ALIGNMENT", 1), ("SEEN_THROUGH", 0)])
def test_where_two_drives_meet_first_any_place_elsewhere_that_was_aligned_counts(reason: str, outdone: int) -> None:
    low = [explaining(0.35, 0.0, None), explaining(0.45, 80.0, reason, score=0.1)]
    assert not_standing_out(low, CONFIG) == {}
    assert len(outdone_contacts(low, [], CONFIG)) == outdone
    known_drive, other_drive = explaining(0.5, 30.0, None), explaining(0.5, 30.0, None, drive=4)
    assert outdone_contacts(low, [known_drive], CONFIG) == {}
    assert len(outdone_contacts(low, [other_drive], CONFIG)) == outdone


def test_the_best_candidate_of_a_spot_speaks_for_it() -> None:
    there = pair(QUERY, at(5.0), [along_x(-5.0)], overlap=0.6)
    assert not_standing_out([explaining(0.35, 0.0, None), there, explaining(0.45, 80.0)], CONFIG) == {}


def near(_row: int, pose: InitialPose) -> PairVerdict:
    return verified(pose.T_match_query)


@pytest.mark.parametrize(("doubt", "decided"), [
    (None, 1), (Doubt.PERCEPTUAL_ALIAS, 0), (Doubt.BETTER_ALTERNATIVE, 0),
])  # fmt: skip
def test_loops_that_do_not_stand_out_support_none(doubt: Doubt | None, decided: int) -> None:
    sure = [on_both_drives(x_m) for x_m in (0.0, 10.0, 20.0)]
    told = sure if doubt is None else [doubted(one, doubt) for one in sure]
    open_one = pair(at(15.0, 2), at(15.0, 1), [along_x(0.0), along_x(8.0)], "AMBIGUOUS", overlap=0.5)
    assert len(with_support([*told, open_one], CONFIG.verification, 5.0, near)) == decided


@pytest.mark.parametrize("doubt", [Doubt.PERCEPTUAL_ALIAS, Doubt.BETTER_ALTERNATIVE])
def test_loops_that_do_not_stand_out_contradict_others(doubt: Doubt) -> None:
    others = [doubted(on_both_drives(x_m, off_m=30.0), doubt) for x_m in (5.0, 15.0)]
    changed = inconsistent([on_both_drives(10.0), *others], CONFIG.verification, 5.0)
    assert changed.keys() == {0} and Doubt.PAIRWISE_INCONSISTENT in changed[0].doubts
    assert len(changed[0].hypotheses) == 2


CLOUD = Station(None, 0, np.eye(4))


def of_cloud(overlap: float, x_m: float, reason: str | None = None, *, drive: int = 1) -> LoopClaim:
    """A claim of a cloud on the submap at `x_m` of a drive, which puts it there."""
    return pair(CLOUD, at(x_m, drive), [along_x(0.0)], reason, overlap=overlap)


@pytest.mark.parametrize("reason", ["AMBIGUOUS", "LOW_SCORE", "DEGENERATE_ALIGNMENT", None])
def test_a_cloud_is_not_placed_where_another_place_of_the_drive_explains_nearly_as_much(reason: str | None) -> None:
    claims = [of_cloud(0.50, 0.0), of_cloud(0.40, 80.0, reason), of_cloud(0.45, 2.0, "LOW_SCORE")]
    judged = accept_cloud(claims, [None] * 3, CONFIG)
    assert not any(one.accepted for one in judged)
    grounds = judged[0].doubts[Doubt.BETTER_ALTERNATIVE]
    assert grounds.figures == {"overlap": 0.50, "elsewhere": 0.40} and "elsewhere 0.40" in grounds.words


def test_a_cloud_is_placed_where_other_places_explain_little_of_it() -> None:
    claims = [of_cloud(0.50, 0.0), of_cloud(0.30, 80.0, "AMBIGUOUS"), of_cloud(0.45, 80.0, "SEEN_THROUGH")]
    assert without_twins(claims, [None] * 3, CONFIG) == {}


def test_drives_that_the_map_places_beside_each_other_say_one_spot() -> None:
    claims = [of_cloud(0.50, 0.0), of_cloud(0.45, 40.0, "LOW_SCORE", drive=2)]
    one_spot = [StationInMap("frame-1", along_x(7.0)), StationInMap("frame-1", along_x(8.0))]
    elsewhere = [one_spot[0], StationInMap("frame-1", along_x(60.0))]
    assert without_twins(claims, one_spot, CONFIG) == {}
    assert without_twins(claims, elsewhere, CONFIG).keys() == {0}


@pytest.mark.parametrize(("reason", "doubted_rows"), [("LOW_SCORE", set()), ("AMBIGUOUS", {0}), (None, set())])
def test_of_drives_that_nothing_places_beside_each_other_ambiguous_claims_count(reason, doubted_rows) -> None:
    claims = [of_cloud(0.50, 0.0), of_cloud(0.45, 40.0, reason, drive=2)]
    frames = [StationInMap("frame-1", along_x(7.0)), StationInMap("frame-2", along_x(60.0))]
    assert without_twins(claims, frames, CONFIG).keys() == doubted_rows
    assert without_twins(claims, [None, None], CONFIG).keys() == doubted_rows
