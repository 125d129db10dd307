"""Where places may repeat, a loop waits for its chain; where a place is distinctive, nothing does."""

from __future__ import annotations

import numpy as np

from revisit.core.acceptance import Decided, Doubt, Drive, LoopClaim, accept, chain, is_decided_by_way, without_waiting
from revisit.core.config import PipelineConfig
from revisit.core.pair_verdict import RejectionReason
from tests.support.claims import STRIDE_M, along_x, at, pair
from tests.support.verdicts import rejected

CONFIG = PipelineConfig()
PERIOD_M = 12.0


def sure(x_m: float, match_m: float | None = None) -> LoopClaim:
    """The query at `x_m` and a match beside it, which passed every check; both drives have the same odometry."""
    match_m = x_m if match_m is None else match_m
    return pair(at(x_m, 2), at(match_m), [along_x(x_m - match_m)])


def ambiguous(x_m: float, match_m: float) -> LoopClaim:
    off_m = x_m - match_m
    poses = [along_x(off_m + shift_m) for shift_m in (PERIOD_M, -PERIOD_M, 0.0)]
    return pair(at(x_m, 2), at(match_m), poses, "AMBIGUOUS")


def driven(before: list[LoopClaim], *new: LoopClaim) -> Decided:
    return accept(new, Drive(before, STRIDE_M), CONFIG, lambda row, near: rejected("LOW_OVERLAP"))


def among_rivals(x_m: float) -> list[LoopClaim]:
    """A pair that passed, and another of the same query that fits at several poses."""
    return [sure(x_m), ambiguous(x_m, x_m - 5.0)]


def test_a_loop_of_a_distinctive_place_is_accepted_at_once() -> None:
    decided = driven([], sure(100.0), sure(100.0, 95.0), ambiguous(100.0, 105.0))
    assert [one.accepted for one in decided.new] == [True, True, False]


def test_a_loop_among_pairs_that_fit_at_several_poses_waits() -> None:
    first = driven([], *among_rivals(100.0)).new[0]
    assert (first.accepted, first.waits, first.reason) == (False, True, RejectionReason.AWAITS_CHAIN)
    assert first.hypotheses and first.doubts.keys() == {Doubt.AWAITS_CHAIN}


def test_it_waits_on_unchanged_while_nothing_decides() -> None:
    before = driven([], *among_rivals(100.0)).new
    assert driven(before, *among_rivals(105.0)).revised == {}


def test_three_loops_that_agree_over_thirty_metres_decide() -> None:
    before = driven([], *among_rivals(100.0)).new
    before += driven(before, *among_rivals(115.0)).new
    assert [one.waits for one in before] == [True, False] * 2
    decided = driven(before, *among_rivals(130.0))
    assert decided.new[0].accepted
    assert [row for row, one in decided.revised.items() if one.accepted] == [0, 2]


def test_loops_that_contradict_each_other_decide_against_both() -> None:
    before = driven([], *among_rivals(100.0)).new
    elsewhere = pair(at(105.0, 2), at(105.0), [along_x(PERIOD_M)])
    decided = driven(before, elsewhere, *among_rivals(105.0)[1:])
    assert decided.revised[0].reason == decided.new[0].reason == RejectionReason.AMBIGUOUS
    assert Doubt.AWAITS_CHAIN not in decided.revised[0].doubts


def test_eighty_metres_of_drive_decide() -> None:
    before = driven([], *among_rivals(100.0)).new
    assert not is_decided_by_way(at(100.0, 2), at(175.0, 2), STRIDE_M)
    assert is_decided_by_way(at(100.0, 2), at(180.0, 2), STRIDE_M)
    assert driven(before, *among_rivals(175.0)).revised == {}
    assert driven(before, *among_rivals(180.0)).revised[0].accepted


def test_a_loop_that_was_accepted_does_not_wait_again() -> None:
    before = driven([], sure(100.0)).new
    decided = driven(before, *among_rivals(105.0))
    assert before[0].accepted and decided.revised == {}


def whole_drive(seed: int) -> list[tuple[bool, RejectionReason | None, set[Doubt]]]:
    """Verdicts at the end of a drive of pairs that pass, are ambiguous, or are a period off, drawn at random."""
    rng, before = np.random.default_rng(seed), list[LoopClaim]()
    for x_m in np.arange(0.0, 150.0, 10.0):
        kinds = [sure(x_m), ambiguous(x_m, x_m - 5.0), pair(at(x_m, 2), at(x_m - 5.0), [along_x(5.0 + PERIOD_M)])]
        new = [one for one, share in zip(kinds, (0.8, 0.6, 0.15), strict=True) if rng.random() < share]
        if new:
            decided = driven(before, *new)
            before = [decided.revised.get(row, one) for row, one in enumerate(before)] + decided.new
    return [(one.accepted, one.reason, set(one.doubts)) for one in without_waiting(before)]


def test_verdicts_at_the_end_of_a_drive_are_those_without_waiting(monkeypatch) -> None:
    waiting = [whole_drive(seed) for seed in range(8)]
    monkeypatch.setattr(chain, "REPEATING", 2.0)
    assert [whole_drive(seed) for seed in range(8)] == waiting
    assert {accepted for one in waiting for accepted, _, _ in one} == {True, False}


def test_what_waits_is_a_loop_once_the_drive_has_ended() -> None:
    ended = without_waiting(driven([], *among_rivals(100.0)).new)
    assert ended[0].accepted and not ended[0].doubts
