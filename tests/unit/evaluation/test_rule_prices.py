"""The price of each rule on a drive: the right loops that it turned down, and the false ones."""

from __future__ import annotations

from revisit.cli import evaluate as command
from revisit.core.acceptance import Doubt, LoopClaim
from revisit.core.index import Match
from revisit.evaluation.datasets import KittiRecording
from revisit.evaluation.described_submaps import DescribedSubmap
from revisit.evaluation.drive_acceptance import AskedPlaces, JudgedCandidate, JudgedDrive, RulePrice, rule_prices
from revisit.evaluation.recording_evaluation import EvaluationOptions, EvaluationResult
from tests.support.claims import along_x, at, doubted, pair

SHARE, ALIAS = Doubt.LOW_CONSISTENT_SHARE, Doubt.PERCEPTUAL_ALIAS


def place(number: int, x_m: float) -> DescribedSubmap:
    T = along_x(x_m)
    return DescribedSubmap(number, (0, 9), T[:3, 3], T, 0.0, None, None, 100)


def judged(claim: LoopClaim) -> JudgedCandidate:
    return JudgedCandidate(Match(0, 0.9), claim)


def test_each_doubt_counts_the_right_and_the_false_loops_that_it_turned_down() -> None:
    places = [place(0, 0.0), place(1, 4.0)]
    right, false = (pair(at(4.0), at(0.0), [along_x(x_m)]) for x_m in (4.0, 12.0))
    claims = [
        doubted(right, SHARE), doubted(false, SHARE), doubted(false, SHARE, ALIAS), right, false,
        pair(at(4.0), at(0.0), [along_x(4.0)], "LOW_SCORE"),
    ]  # fmt: skip
    prices = rule_prices(
        AskedPlaces(places, places), JudgedDrive([[], [judged(claim) for claim in claims]], [0.0, 0.0])
    )
    assert prices == {SHARE.value: RulePrice(1, 2), ALIAS.value: RulePrice(0, 1)}


def test_the_command_shows_them_in_one_table(monkeypatch, capsys) -> None:
    rules = {SHARE.value: {"right_lost": 41, "false_stopped": 2}}
    result = EvaluationResult([], {"submaps": 7, "rules": rules})
    monkeypatch.setattr("revisit.evaluation.recording_evaluation.evaluate", lambda *_, **__: result)
    command._evaluate(KittiRecording.__new__(KittiRecording), EvaluationOptions(), None)
    shown = capsys.readouterr().out
    row = next(line for line in shown.splitlines() if SHARE.value in line)
    assert [int(word) for word in row.split() if word.isdigit()] == [41, 2]
    assert "false loops stopped" in shown and "rules." not in shown
