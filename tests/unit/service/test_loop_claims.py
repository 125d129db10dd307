"""Loops as rows and as claims: one is turned into the other without a loss."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from revisit.core.acceptance import Doubt, Grounds, LoopClaim, Station, Support
from revisit.core.config import PipelineConfig, VerificationConfig
from revisit.core.geometry import se3
from revisit.core.geometry.se3 import pose_row
from revisit.core.verification import RejectedLoop, RejectionReason
from revisit.service.features.loops.claims import (
    claim_of_row,
    evidence_of,
    loop_state,
    revised_evidence,
    station,
    verdict_evidence,
)
from tests.support.claims import WORDS, along_x, at, doubted, pair
from tests.support.records import a_loop, a_submap
from tests.support.verdicts import ambiguous

RULES = PipelineConfig().verification
QUERY = a_submap("q", 7, number=203, session_number=2, T_odom_submap=pose_row(along_x(35.0)))
MATCH = a_submap("m", 4, number=103, session_number=1, T_odom_submap=pose_row(along_x(20.0)))


def stored_and_read(claim: LoopClaim) -> LoopClaim:
    """The claim through a row of the database."""
    evidence = json.loads(json.dumps(evidence_of(claim, RULES), allow_nan=False))
    row = replace(
        a_loop(203, 103),
        state=loop_state(claim).value,
        reason=None if claim.reason is None else claim.reason.value,
        score=claim.score,
        T_match_query=None if claim.T_match_query is None else pose_row(claim.T_match_query),
        evidence=evidence,
    )
    return claim_of_row(row, QUERY, MATCH)


def assert_same(one: LoopClaim, other: LoopClaim) -> None:
    assert (one.accepted, one.reason, one.score, one.overlap) == (
        other.accepted,
        other.reason,
        other.score,
        other.overlap,
    )
    assert (one.speaks, one.withdrawn, one.accepted_by_itself) == (
        other.speaks,
        other.withdrawn,
        other.accepted_by_itself,
    )
    assert one.doubts == other.doubts and one.height_m == other.height_m
    np.testing.assert_allclose(one.hypotheses, other.hypotheses)


def test_a_claim_of_every_kind_is_read_as_it_was_stored() -> None:
    covariance = np.diag([0.1, 0.1, 0.04, 0.01, 0.01, 0.01])
    loop = pair(station(QUERY), station(MATCH), [along_x(15.0), along_x(23.0)], overlap=0.5, covariance=covariance)
    several = pair(station(QUERY), station(MATCH), [along_x(15.0), along_x(23.0)], "AMBIGUOUS")
    low = pair(station(QUERY), station(MATCH), [along_x(15.0)], "LOW_SCORE", 0.2)
    for claim in (loop, several, low, *(doubted(loop, doubt) for doubt in Doubt)):
        assert_same(stored_and_read(claim), claim)
    share = replace(loop, doubts={Doubt.LOW_CONSISTENT_SHARE: Grounds("few", {"evident": 1, "pairs": 4})})
    assert_same(stored_and_read(share), share)
    supported = replace(doubted(loop, Doubt.PAIRWISE_INCONSISTENT), support=Support(2, 3, 15.25, (along_x(23.0),)))
    read = stored_and_read(supported)
    assert_same(read, supported)
    assert read.support is not None and read.support.words == supported.support.words
    np.testing.assert_array_equal(read.support.ruled_out, supported.support.ruled_out)


def test_what_a_person_has_accepted_is_not_doubted_any_more() -> None:
    claim = doubted(pair(station(QUERY), station(MATCH), [along_x(15.0)]), Doubt.PERCEPTUAL_ALIAS)
    row = replace(a_loop(203, 103), T_match_query=pose_row(along_x(15.0)), evidence=evidence_of(claim, RULES))
    assert claim_of_row(row, QUERY, MATCH).accepted_by_itself


def test_the_rivals_of_an_ambiguous_loop_are_told_with_their_overlap_and_pose() -> None:
    verdict = ambiguous([np.eye(4), se3.from_yaw(0.0, (8.0, 0.0, 0.0))], overlap=0.625)
    told = json.loads(json.dumps(verdict_evidence(verdict, RULES), allow_nan=False))["measurement"]["rivals"]
    assert told == [{"overlap": 0.625, "T_match_query": along_x(8.0).tolist()}]


def test_a_damaged_place_is_told_with_its_message() -> None:
    lost = LoopClaim(at(0.0, 2), at(0.0), RejectedLoop(RejectionReason.PLACE_LOST, message="checksum"))
    evidence = evidence_of(lost, RULES)
    assert evidence["message"] == "checksum" and evidence["measurement"] == {}


def test_revised_evidence_keeps_the_rules_of_a_pair_that_was_not_verified_again() -> None:
    loop = pair(Station(2, 1, np.eye(4)), Station(1, 1, np.eye(4)), [along_x(0.0)])
    stored = {**evidence_of(replace(loop, support=Support(2, 2, 15.0, ())), RULES), "model_version": "m", "recall": {}}
    stricter = VerificationConfig(min_score=0.9)
    lost = revised_evidence(stored, replace(loop, doubts={Doubt.SUPPORT_LOST: WORDS}), stricter)
    assert "support" not in lost and lost["doubts"] == {"SUPPORT_LOST": {"words": WORDS.words}}
    assert lost["thresholds"]["min_score"] == RULES.min_score and lost["model_version"] == "m"
    again = revised_evidence(lost, replace(loop, support=Support(3, 3, 15.0, ())), stricter)
    assert "doubts" not in again and again["support"]["anchors"] == 3 and again["recall"] == {}
    assert again["thresholds"]["min_score"] == 0.9
