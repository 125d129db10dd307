"""A loop that others have decided falls with them."""

from __future__ import annotations

from dataclasses import replace

from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_row
from revisit.service.application.contract.recogniser import LoopVerdict
from revisit.service.application.contract.records import SubmapRecord
from revisit.service.application.recognise.loops_beside import Beside, revised_evidence, supported, unsupported
from tests.support.records import a_loop, a_submap

CONFIG = VerificationConfig()
STRIDE_M = 5.0
PERIOD = se3.from_yaw(0.0, (16.0, 0.0, 0.0))
WORDS = {"words": "said otherwise"}


def submap(session: int, place: int) -> SubmapRecord:
    T_odom_submap = pose_row(se3.from_yaw(0.0, (STRIDE_M * place, 0.0, 0.0)))
    name = f"s{session}-{place}"
    return a_submap(name, place, number=100 * session + place, session_number=session, T_odom_submap=T_odom_submap)


def loop(place: int, accepted: bool = True, **evidence: object) -> Beside:
    """Two drives in one frame meet at `place`: a loop of what both saw there."""
    verdict = LoopVerdict(accepted, None if accepted else "AMBIGUOUS", 0.9, se3.from_yaw(0.0), dict(evidence))
    return Beside(submap(2, place), submap(1, place), 0.9, verdict)


DECIDED = loop(3, support={"ruled_out": [PERIOD.tolist()], "anchors": 2}, measurement={"overlap": 0.5})
STANDING = [loop(0), loop(1)]
FALLEN = [loop(0, False, contradicted=WORDS), loop(1, False, contradicted=WORDS)]


def lost(loops: list[Beside]) -> list[Beside]:
    return unsupported(loops, CONFIG, STRIDE_M)


def test_a_loop_whose_anchors_were_contradicted_is_ambiguous_again() -> None:
    (changed,) = lost([*FALLEN, DECIDED])
    assert (changed.key, changed.verdict.accepted, changed.verdict.reason) == (DECIDED.key, False, "AMBIGUOUS")
    assert "support" not in changed.verdict.evidence
    assert changed.verdict.evidence["support_lost"]["words"]
    assert changed.verdict.evidence["measurement"]["rivals"] == [{"overlap": 0.5, "T_match_query": PERIOD.tolist()}]
    assert len(changed.hypotheses) == 2


def test_a_loop_keeps_its_support_where_enough_anchors_are_left() -> None:
    assert lost([*STANDING, DECIDED]) == []
    assert lost([*STANDING, loop(4), loop(2, False, contradicted=WORDS), DECIDED]) == []


def test_a_loop_does_not_fall_with_one_that_had_said_something_else() -> None:
    other = loop(0, False, contradicted=WORDS)
    assert lost([replace(other, verdict=replace(other.verdict, T_match_query=PERIOD)), DECIDED]) == []


def test_what_a_person_has_made_stays_and_what_stands_by_itself_needs_no_support() -> None:
    assert lost([*FALLEN, loop(3)]) == []
    by_hand = replace(DECIDED, record=replace(a_loop(203, 103), manual=True))
    assert lost([*FALLEN, by_hand]) == []


def test_loops_that_stand_out_from_no_other_place_support_none() -> None:
    rivals = [{"overlap": 0.5, "T_match_query": PERIOD.tolist()}]
    asked = loop(3, False, measurement={"rivals": rivals})
    alike = [loop(place, False, look_alikes=WORDS) for place in range(3)]
    by_themselves = [loop(place) for place in range(3)]

    def register(*pair: object) -> LoopVerdict:
        return loop(3).verdict

    assert supported([*alike, asked], CONFIG, STRIDE_M, register) == []
    (decided,) = supported([*by_themselves, asked], CONFIG, STRIDE_M, register)
    assert decided.verdict.accepted and decided.verdict.evidence["support"]["anchors"] == 3


def test_stored_evidence_says_of_support_what_the_last_verdict_says() -> None:
    stored = {"support": {"anchors": 2}, "model_version": "m", "measurement": {"overlap": 0.5}}
    lost_now = {"support_lost": WORDS, "measurement": {"overlap": 0.6}}
    assert revised_evidence(stored, lost_now) == {"model_version": "m", **lost_now}
    again = {"support": {"anchors": 3}}
    assert "support_lost" not in revised_evidence(revised_evidence(stored, lost_now), again)
