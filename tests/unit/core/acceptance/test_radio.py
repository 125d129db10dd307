"""RADIO_DISAGREES: twins of one plan are told apart by radio, and by radio that can be trusted alone."""

from __future__ import annotations

from dataclasses import replace

import pytest

from revisit.core.acceptance import Doubt, Drive, LoopClaim, accept
from revisit.core.acceptance.radio import radio_refuted
from revisit.core.config import PipelineConfig
from revisit.core.pair_verdict import PairVerdict
from revisit.core.radio import RadioFingerprint
from tests.support.claims import STRIDE_M, WORDS, along_x, at, pair
from tests.support.verdicts import rejected, verified

TWIN_M = 150.0
"""How far along its drive the twin lies."""


def radio(*names: int) -> RadioFingerprint:
    return RadioFingerprint.of([{bytes([name] * 8): -50.0 for name in names}])


HERE, THERE, OTHERS = radio(1, 2, 3, 4, 5), radio(6, 7, 8, 9, 10), radio(11, 12, 13, 14)


def claim(
    twin_m: float, told: RadioFingerprint | None, of_query: RadioFingerprint | None = HERE, x_m: float = 20.0, **more
) -> LoopClaim:
    """A pair that passed: the submap of a drive at `x_m` stands where that of another one was, so far along, does."""
    made = pair(at(x_m, drive=2), at(x_m + twin_m), [along_x(0.0)], **more)
    return replace(made, query=replace(made.query, radio=of_query), match=replace(made.match, radio=told))


AGREE = tuple(claim(0.0, HERE, x_m=x_m) for x_m in (0.0, 5.0))
"""Loops on the way that agree with radio."""


def passes_nowhere(row: int, near: object) -> PairVerdict:
    """What is verified again passes nowhere."""
    return rejected("LOW_SCORE")


def accepted(*new: LoopClaim, before: tuple[LoopClaim, ...] = AGREE) -> list[LoopClaim]:
    return accept(new, Drive(before, STRIDE_M), PipelineConfig(), passes_nowhere).new


def test_of_two_twins_that_pass_the_one_that_hears_the_same_is_a_loop():
    right, twin = accepted(claim(0.0, HERE), claim(TWIN_M, THERE, overlap=0.9))
    assert twin.doubts.keys() == {Doubt.RADIO_DISAGREES} and twin.ambiguous
    assert "hears 0.00 of the radio there, and 1.00 at another spot" in twin.doubts[Doubt.RADIO_DISAGREES].words
    assert right.doubts.keys() <= {Doubt.AWAITS_CHAIN} and not right.ambiguous


def test_an_ambiguous_twin_does_not_outdo_a_loop_that_radio_knows():
    poses = [along_x(0.0), along_x(8.0)]
    twin = claim(TWIN_M, THERE)
    rivals = pair(twin.query, twin.match, poses, "AMBIGUOUS", overlap=0.9)
    without = replace(rivals, match=replace(rivals.match, radio=None))
    assert Doubt.BETTER_ALTERNATIVE in accepted(claim(0.0, HERE, overlap=0.5), without)[0].doubts
    right, left = accepted(claim(0.0, HERE, overlap=0.5), rivals)
    assert not right.ambiguous and (left.verdict, left.doubts) == (rivals.verdict, {})


@pytest.mark.parametrize("told", [None, radio(1, 2)], ids=["none", "too few"])
def test_where_a_place_tells_nothing_claims_are_as_without_radio(told):
    new = (claim(0.0, HERE), claim(TWIN_M, told))
    assert radio_refuted(new, AGREE) == {}
    bare = [claim(0.0, None, None), claim(TWIN_M, None, None)]
    assert [one.doubts for one in accepted(*new)] == [one.doubts for one in accepted(*bare)]


def test_access_points_that_were_replaced_refute_nothing():
    assert radio_refuted((claim(0.0, OTHERS), claim(TWIN_M, OTHERS)), AGREE) == {}
    assert radio_refuted((claim(0.0, THERE), claim(TWIN_M, OTHERS)), AGREE) == {}


def test_a_place_of_the_same_spot_is_no_twin():
    beside = replace(claim(10.0, THERE), verdict=pair(at(20.0), at(30.0), [along_x(-10.0)]).verdict)
    assert radio_refuted((claim(0.0, HERE), beside), AGREE) == {}


def test_a_place_far_away_need_not_hear_as_much():
    half = radio(1, 2, 3, 20, 21)  # three of seven that both hear, 0.43
    far = replace(claim(TWIN_M, half), verdict=pair(at(20.0), at(170.0), [along_x(40.0)]).verdict)
    assert radio_refuted((claim(0.0, HERE), claim(TWIN_M, half)), AGREE).keys() == {1}
    assert radio_refuted((claim(0.0, HERE), far), AGREE) == {}


@pytest.mark.parametrize("wrong_m", [30.0, 80.0, 40_000.0])
def test_a_false_pose_far_away_does_not_make_a_place_louder(wrong_m):
    right, its = claim(0.0, radio(1, 2, 3, 4, 20)), radio(1, 2, 20, 21, 22, 23)  # they hear 0.67 and 0.22 of the same
    beside = pair(right.query, replace(at(50.0), radio=its), [along_x(wrong_m), along_x(-32.0)], "AMBIGUOUS")
    assert radio_refuted((right, beside), AGREE) == {}
    assert 0 not in radio_refuted((right, replace(beside, verdict=verified(along_x(wrong_m)))), AGREE)


def test_loops_of_a_drive_with_itself_say_nothing_of_the_radio_of_others():
    own = tuple(replace(one, match=replace(one.match, drive=2)) for one in AGREE)
    new = claim(0.0, HERE), claim(TWIN_M, THERE)
    assert radio_refuted(new, AGREE).keys() == {1} and radio_refuted(new, own) == {}
    with_itself = [replace(one, match=replace(one.match, drive=2)) for one in new]
    assert radio_refuted(with_itself, own).keys() == {1} and radio_refuted(with_itself, AGREE) == {}


def test_a_place_of_another_drive_is_not_held_against_it():
    other = claim(TWIN_M, THERE)
    assert radio_refuted((claim(0.0, HERE), replace(other, match=replace(other.match, drive=9))), AGREE) == {}


@pytest.mark.parametrize(
    ("wrong", "right", "refutes"), [(0, 0, False), (0, 1, False), (0, 2, True), (1, 4, True), (1, 3, False)]
)
def test_radio_is_trusted_where_loops_on_the_way_agree_with_it(wrong, right, refutes):
    before = wrong * [claim(0.0, THERE)] + right * [AGREE[0]]
    assert bool(radio_refuted((claim(0.0, HERE), claim(TWIN_M, THERE)), before)) == refutes
    doubted = [replace(one, doubts={Doubt.PERCEPTUAL_ALIAS: WORDS}) for one in before]
    assert radio_refuted((claim(0.0, HERE), claim(TWIN_M, THERE)), doubted) == {}


def test_a_loop_of_a_person_stays():
    twin = replace(claim(TWIN_M, THERE), by_hand=True)
    assert radio_refuted((claim(0.0, HERE), twin), AGREE) == {1: twin}
