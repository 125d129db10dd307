"""An accepted loop is ambiguous where most pairs that its pose explains do not pass by themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from revisit.core.acceptance import Doubt, LoopClaim, Station
from revisit.core.acceptance.consistent_share import EvidentShare, evident_shares, low_consistent_share
from revisit.core.acceptance.support import with_support, without_lost_support
from revisit.core.config import PipelineConfig
from revisit.core.geometry import se3
from revisit.core.verification import InitialPose, PairVerdict
from tests.support.claims import STRIDE_M, along_x, at, doubted, pair
from tests.support.verdicts import verified

CONFIG = PipelineConfig().verification


def loop(x_m: float, reason: str | None, *, off_m: float = 0.0, rival_m: float = 40.0) -> LoopClaim:
    """A pair of submaps at `x_m` of two drives, and a pose `off_m` from the same place; a rival, if ambiguous."""
    return pair(at(x_m, 2), at(x_m, 1), [along_x(off_m), along_x(rival_m)], reason, overlap=0.5)


def row(reason: str, count: int, **more: float) -> list[LoopClaim]:
    return [loop(10.0 + STRIDE_M * place, reason, **more) for place in range(count)]


def near(_row: int, pose: InitialPose) -> PairVerdict:
    return verified(pose.T_match_query, overlap=0.5)


@pytest.mark.parametrize("reason", ["AMBIGUOUS", "LOW_SCORE"])
def test_a_loop_that_passes_where_most_pairs_of_its_pose_do_not_is_ambiguous(reason: str) -> None:
    changed = low_consistent_share([loop(5.0, None), *row(reason, 3)], STRIDE_M)
    assert changed.keys() == {0} and (changed[0].accepted, changed[0].reason) == (False, "AMBIGUOUS")
    grounds = changed[0].doubts[Doubt.LOW_CONSISTENT_SHARE]
    assert grounds.figures == {"evident": 1, "pairs": 4}
    assert "of 4 pairs of submaps that its pose explains only 1 did" in grounds.words
    assert low_consistent_share([loop(5.0, None), *row(reason, 1)], STRIDE_M) == {}


def test_a_rival_of_an_ambiguous_pair_counts_as_its_pose() -> None:
    others = row("AMBIGUOUS", 3, off_m=30.0, rival_m=0.0)
    assert len(low_consistent_share([loop(5.0, None), *others], STRIDE_M)) == 1


@pytest.mark.parametrize("others", [
    row("AMBIGUOUS", 3, off_m=8.0),  # another pose
    row("DEGENERATE_ALIGNMENT", 3),  # nothing keeps them from sliding
    row("SEEN_THROUGH", 3),
    [loop(90.0 + place, "AMBIGUOUS") for place in (0.0, 5.0, 10.0)],  # too far along the drive
    [replace(one, match=replace(one.match, drive=9)) for one in row("AMBIGUOUS", 3)],  # another drive
])  # fmt: skip
def test_other_poses_other_drives_and_pairs_far_away_say_nothing(others: list[LoopClaim]) -> None:
    assert low_consistent_share([loop(5.0, None), *others], STRIDE_M) == {}


def test_a_loop_that_a_person_made_stays() -> None:
    made = replace(loop(5.0, None), by_hand=True)
    assert low_consistent_share([made, *row("AMBIGUOUS", 3)], STRIDE_M) == {}


@pytest.mark.parametrize(("doubt", "evident"), [
    (Doubt.LOW_CONSISTENT_SHARE, True), (Doubt.PAIRWISE_INCONSISTENT, True), (Doubt.BETTER_ALTERNATIVE, False),
])  # fmt: skip
def test_what_was_withdrawn_counts_as_passed_but_not_what_stands_out_from_nothing(doubt: Doubt, evident: bool) -> None:
    loops = [loop(5.0, None), doubted(loop(7.0, None), doubt), *row("AMBIGUOUS", 2)]
    changed = low_consistent_share(loops, STRIDE_M)
    assert all(one.accepted for one in changed.values()) is evident


def test_a_loop_is_believed_again_when_more_pairs_pass() -> None:
    one = doubted(loop(5.0, None), Doubt.LOW_CONSISTENT_SHARE)
    assert low_consistent_share([one, *row("AMBIGUOUS", 3)], STRIDE_M) == {}
    believed = low_consistent_share([one, loop(8.0, None), *row("AMBIGUOUS", 3)], STRIDE_M)
    assert believed.keys() == {0} and believed[0].accepted_by_itself and not believed[0].doubts
    contradicted = doubted(one, Doubt.LOW_CONSISTENT_SHARE, Doubt.PAIRWISE_INCONSISTENT)
    assert low_consistent_share([contradicted, loop(8.0, None)], STRIDE_M) == {}


def test_support_falls_with_loops_that_are_outnumbered() -> None:
    anchors = [loop(x_m, None) for x_m in (0.0, 10.0, 20.0)]
    decided = with_support([*anchors, loop(15.0, "AMBIGUOUS", rival_m=8.0)], CONFIG, STRIDE_M, near)
    assert decided.keys() == {3} and decided[3].decided_by_others
    withdrawn = [doubted(one, Doubt.LOW_CONSISTENT_SHARE) for one in anchors]
    assert without_lost_support([*anchors, decided[3]], CONFIG, STRIDE_M) == {}
    lost = without_lost_support([*withdrawn, decided[3]], CONFIG, STRIDE_M)
    assert Doubt.SUPPORT_LOST in lost[3].doubts and not lost[3].accepted


def test_the_share_does_not_depend_on_where_the_frames_of_the_drives_lie() -> None:
    rng = np.random.default_rng(3)
    T_first, T_second = (se3.from_yaw(yaw, (x, y, 0.3)) for yaw, x, y in rng.uniform(-3, 3, (2, 3)))
    turned = se3.from_yaw(np.pi, (2.0, 1.0, 0.0))
    pairs = []
    for place in range(8):
        T_query, T_match = se3.from_yaw(0.1 * place, (4.0 * place, 0, 0)), se3.from_yaw(0.5, (4.0 * place, 2.0, 0))
        query, match = Station(2, place, T_first @ T_query), Station(1, place, T_second @ T_match)
        true = se3.inverse(T_match) @ T_query
        poses = [true] if place < 2 else [turned @ true, true] if place < 6 else [turned @ true]
        pairs.append(pair(query, match, poses, None if place < 2 else "AMBIGUOUS"))
    assert evident_shares(pairs, [0, 1], 4.0) == [EvidentShare(2, 6)] * 2
    assert EvidentShare(4, 11).is_enough and not EvidentShare(1, 3).is_enough
    assert evident_shares(pairs, [], 4.0) == []
