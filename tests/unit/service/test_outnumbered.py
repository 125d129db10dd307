"""An accepted loop is ambiguous where most pairs that its pose explains do not pass by themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from revisit.core.config import PipelineConfig
from revisit.core.drive_loops import DriveSubmap
from revisit.core.evident_share import EvidentShare, TestedPair, evident_shares
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_row
from revisit.service.application.contract.recogniser import LoopVerdict
from revisit.service.application.recognise.loops_beside import Beside, supported, unsupported
from revisit.service.application.recognise.outnumbered import outnumbered
from tests.support.records import a_submap

CONFIG = PipelineConfig().verification
STRIDE_M = 5.0


def loop(
    x_m: float, reason: str | None, *, off_m: float = 0.0, told: str | None = None, rival_m: float = 40.0
) -> Beside:
    """A pair of submaps at `x_m` of two drives, and a pose `off_m` from the same place; a rival, if ambiguous."""
    number = int(x_m)
    ends = [
        a_submap(f"{name}{number}", int(x_m // STRIDE_M), number=base + number, session_number=session,
                 T_odom_submap=pose_row(se3.from_yaw(0.0, (x_m, 0, 0))))
        for name, base, session in (("q", 5_000, 2), ("m", 1_000, 1))
    ]  # fmt: skip
    measured = {"overlap": 0.5, "rivals": []}
    if reason == "AMBIGUOUS" and told is None:
        pose = se3.from_yaw(0.0, (rival_m, 0, 0)).tolist()
        measured = {"overlap": 0.5, "rivals": [{"overlap": 0.5, "T_match_query": pose}]}
    evidence = {"measurement": measured, **({} if told is None else {told: {}})}
    verdict = LoopVerdict(reason is None, reason, 0.9, se3.from_yaw(0.0, (off_m, 0, 0)), evidence)
    return Beside(ends[0], ends[1], 0.9, verdict)


def row(reason: str, count: int, **more: float) -> list[Beside]:
    return [loop(10.0 + STRIDE_M * place, reason, **more) for place in range(count)]


@pytest.mark.parametrize("reason", ["AMBIGUOUS", "LOW_SCORE"])
def test_a_loop_that_passes_where_most_pairs_of_its_pose_do_not_is_ambiguous(reason: str) -> None:
    (changed,) = outnumbered([loop(5.0, None), *row(reason, 3)], STRIDE_M)
    assert (changed.verdict.accepted, changed.verdict.reason) == (False, "AMBIGUOUS")
    told = changed.verdict.evidence["outnumbered"]
    assert (told["evident"], told["pairs"]) == (1, 4)
    assert "of 4 pairs of submaps that its pose explains only 1 did" in told["words"]
    assert outnumbered([loop(5.0, None), *row(reason, 1)], STRIDE_M) == []


def test_a_rival_of_an_ambiguous_pair_counts_as_its_pose() -> None:
    others = row("AMBIGUOUS", 3, off_m=30.0, rival_m=0.0)
    assert len(outnumbered([loop(5.0, None), *others], STRIDE_M)) == 1


@pytest.mark.parametrize("others", [
    row("AMBIGUOUS", 3, off_m=8.0),  # another pose
    row("DEGENERATE_ALIGNMENT", 3),  # nothing keeps them from sliding
    row("SEEN_THROUGH", 3),
    [loop(90.0 + place, "AMBIGUOUS") for place in (0.0, 5.0, 10.0)],  # too far along the drive
    [replace(one, match=replace(one.match, session_number=9)) for one in row("AMBIGUOUS", 3)],  # another drive
])  # fmt: skip
def test_other_poses_other_drives_and_pairs_far_away_say_nothing(others: list[Beside]) -> None:
    assert outnumbered([loop(5.0, None), *others], STRIDE_M) == []


def test_a_loop_that_a_person_made_stays() -> None:
    made = loop(5.0, None)
    by_hand = type("Record", (), {"manual": True, "number": 7})()
    assert outnumbered([replace(made, record=by_hand), *row("AMBIGUOUS", 3)], STRIDE_M) == []  # type: ignore[arg-type]


@pytest.mark.parametrize(("told", "evident"), [("outnumbered", True), ("contradicted", True), ("outdone", False)])
def test_what_was_withdrawn_counts_as_passed_but_not_what_stands_out_from_nothing(told: str, evident: bool) -> None:
    loops = [loop(5.0, None), loop(7.0, "AMBIGUOUS", told=told), *row("AMBIGUOUS", 2)]
    doubted = [one for one in outnumbered(loops, STRIDE_M) if not one.verdict.accepted]
    assert (doubted == []) is evident


def test_a_loop_is_believed_again_when_more_pairs_pass() -> None:
    doubted = loop(5.0, "AMBIGUOUS", told="outnumbered")
    assert outnumbered([doubted, *row("AMBIGUOUS", 3)], STRIDE_M) == []
    (believed,) = outnumbered([doubted, loop(8.0, None), *row("AMBIGUOUS", 3)], STRIDE_M)
    assert believed.accepted_by_itself and "outnumbered" not in believed.verdict.evidence
    contradicted = replace(doubted.verdict, evidence={**doubted.verdict.evidence, "contradicted": {}})
    assert outnumbered([replace(doubted, verdict=contradicted), loop(8.0, None)], STRIDE_M) == []


def test_support_falls_with_loops_that_are_outnumbered() -> None:
    anchors = [loop(x_m, None) for x_m in (0.0, 10.0, 20.0)]
    open_one = loop(15.0, "AMBIGUOUS", rival_m=8.0)

    def register(query: object, match: object, similarity: float, near: np.ndarray) -> LoopVerdict:
        return LoopVerdict(True, None, 0.9, near, {"measurement": {"overlap": 0.5}})

    (decided,) = supported([*anchors, open_one], CONFIG, STRIDE_M, register)
    withdrawn = [loop(x_m, "AMBIGUOUS", told="outnumbered") for x_m in (0.0, 10.0, 20.0)]
    assert unsupported([*anchors, decided], CONFIG, STRIDE_M) == []
    (lost,) = unsupported([*withdrawn, decided], CONFIG, STRIDE_M)
    assert "support_lost" in lost.verdict.evidence


def test_the_share_does_not_depend_on_where_the_frames_of_the_drives_lie() -> None:
    rng = np.random.default_rng(3)
    T_first, T_second = (se3.from_yaw(yaw, (x, y, 0.3)) for yaw, x, y in rng.uniform(-3, 3, (2, 3)))
    turned = se3.from_yaw(np.pi, (2.0, 1.0, 0.0))
    pairs = []
    for place in range(8):
        T_query, T_match = se3.from_yaw(0.1 * place, (4.0 * place, 0, 0)), se3.from_yaw(0.5, (4.0 * place, 2.0, 0))
        query, match = DriveSubmap(T_first @ T_query, place), DriveSubmap(T_second @ T_match, place)
        true = se3.inverse(T_match) @ T_query
        poses = [true] if place < 2 else [turned @ true, true] if place < 6 else [turned @ true]
        pairs.append(TestedPair(query, match, poses, evident=place < 2))
    assert evident_shares(pairs, [0, 1], 4.0) == [EvidentShare(2, 6)] * 2
    assert EvidentShare(4, 11).is_enough and not EvidentShare(1, 3).is_enough
    assert evident_shares(pairs, [], 4.0) == []
