"""Poses and brief evidence as a database holds them: small, and read back as they were written."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from revisit.service.engines.sql.packed_columns import (
    MeasuredCovariance,
    PackedEvidence,
    PackedPose,
    packed_brief,
    unpacked_brief,
)

POSE = (*np.random.default_rng(3).normal(size=12).tolist(), 0.0, 0.0, 0.0, 1.0)
DIALECT = None  # neither type asks for it


def covariance(seed: int, scale: float = 1.0) -> np.ndarray:
    """A covariance with strong correlations, metres and radians."""
    rng = np.random.default_rng(seed)
    spread = rng.normal(size=(6, 6)) * [[0.4], [0.5], [0.2], [1e-3], [1e-3], [2e-3]]
    return scale * (spread @ spread.T + 1e-9 * np.eye(6))


def brief(seed: int = 0, **changed) -> dict:
    """What is kept of a rejected pair."""
    measured = {
        "inliers": 4, "overlap": 0.1324, "contrast": -0.0082, "seen_through": None, "rmse_m": 0.1239,
        "common_share": 0.3984, "enough_share": 0.35, "covariance": covariance(seed).tolist(),
    }  # fmt: skip
    rules = {"min_score": 0.5, "min_overlap": 0.2, "max_seen_through": 0.35}
    members = {"thresholds": rules, "thresholds_version": "0123456789ab", "model_version": "revisit-c770bc1eb8cd"}
    return {"measurement": {**measured, **changed}, **members}


def stored(evidence: dict) -> bytes:
    data = PackedEvidence().process_bind_param(evidence, DIALECT)
    assert data is not None
    return data


def test_brief_evidence_takes_at_most_a_hundred_bytes():
    assert len(stored(brief())) <= 100 < len(json.dumps(brief())) / 10


def test_the_rules_of_a_verdict_take_less_than_forty_bytes_and_are_kept():
    rules = {name: value for name, value in brief().items() if name != "measurement"}
    assert len(stored(rules)) < 40 and PackedEvidence().process_result_value(stored(rules), DIALECT) == rules


@pytest.mark.parametrize("scale", [1e-8, 1.0, 1e6])
def test_brief_evidence_is_read_back_with_its_covariance_to_a_thousandth(scale):
    known = brief(covariance=covariance(1, scale).tolist())
    read = PackedEvidence().process_result_value(stored(known), DIALECT)
    was, now = (np.array(one["measurement"].pop("covariance")) for one in (known, read))
    assert read == known
    sigma = np.sqrt(np.diag(was))
    assert np.abs((now - was) / np.outer(sigma, sigma)).max() < 2e-3
    assert np.linalg.eigvalsh(now / np.outer(sigma, sigma)).min() > 0


@settings(max_examples=50)
@given(st.integers(0, 10_000))
@example(65)  # the largest number of a row rounds up to 1
def test_what_was_read_is_written_again_as_the_same_bytes(seed):
    data = packed_brief(brief(seed))
    assert data is not None and packed_brief(unpacked_brief(data)) == data


@pytest.mark.parametrize(
    "evidence",
    [
        {},
        {"agreement": 0.1},
        {**brief(), "recall": {"reason": "LOW_OVERLAP"}},
        brief(rivals=[]),
        brief(rmse_m=400.0),
        brief(covariance=np.zeros((6, 6)).tolist()),
        {**brief(), "thresholds": {"min_score": 0.5, "min_overlap": 1 / 3, "max_seen_through": 0.35}},
        {**brief(), "thresholds_version": "none"},
    ],
)
def test_any_other_evidence_is_kept_to_the_bit(evidence):
    assert PackedEvidence().process_result_value(stored(evidence), DIALECT) == evidence


def test_a_pose_takes_97_bytes_and_keeps_every_bit():
    data = PackedPose().process_bind_param(POSE, DIALECT)
    assert data is not None and len(data) == 97
    assert PackedPose().process_result_value(data, DIALECT) == POSE
    sheared = (*POSE[:12], 0.0, 0.0, 0.1, 1.0)
    assert PackedPose().process_result_value(PackedPose().process_bind_param(sheared, DIALECT), DIALECT) == sheared
    assert PackedPose().process_bind_param(None, DIALECT) is None


def test_what_an_earlier_version_wrote_as_json_is_read():
    assert PackedPose().process_result_value(json.dumps(POSE).encode(), DIALECT) == POSE
    assert PackedEvidence().process_result_value(json.dumps(brief()).encode(), DIALECT) == brief()


def measured(seed: int = 0, **changed) -> dict:
    """What is kept of an accepted loop."""
    shares = np.random.default_rng(seed).uniform(size=6).tolist()
    names = ("similarity", "inlier_ratio", "overlap", "contrast", "seen_through", "score")
    matrices = {"T_match_query": np.reshape(POSE, (4, 4)).tolist(), "covariance": covariance(seed).tolist()}
    own = {**dict(zip(names, shares, strict=True)), "inliers": 5, **matrices, "rivals": []}
    known = {**brief(), "distinctiveness": {"compared": 9, "passing": 2, "other_spots": 0}}
    return {**known, "measurement": {**own, **changed}}


def read_back(evidence: dict) -> dict:
    return PackedEvidence().process_result_value(stored(evidence), DIALECT)


def test_the_evidence_of_an_accepted_loop_takes_a_third_of_its_json_and_is_read_back_to_the_bit():
    known = measured()
    assert len(stored(known)) < len(json.dumps(known, separators=(",", ":"))) / 3
    assert json.dumps(read_back(known)) == json.dumps(known)
    assert stored(known)[:1] == b"\x03", "stored by an earlier version: other bytes are another form"


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False, width=64), min_size=36, max_size=36), st.booleans())
@example([-0.0] * 36, True)
def test_any_covariance_is_read_back_to_the_bit_by_evidence_and_by_pose_graphs(numbers, symmetric):
    matrix = np.reshape(numbers, (6, 6))
    matrix = np.tril(matrix) + np.tril(matrix, -1).T if symmetric else matrix
    known = measured(covariance=matrix.tolist())
    assert json.dumps(read_back(known)) == json.dumps(known)
    graph = MeasuredCovariance().process_result_value(stored(known), DIALECT)
    assert json.dumps(graph["measurement"]["covariance"]) == json.dumps(matrix.tolist())


@pytest.mark.parametrize(
    "changed",
    [
        {"T_match_query": None},
        {"T_match_query": [[1.0, 0.0], [0.0, 1.0]]},
        {"T_match_query": np.full((4, 4), 0.5).tolist()},
        {"covariance": None},
        {"covariance": [[None] * 6] * 6},
        {"covariance": [[0] * 6] * 6},
        {"rivals": [{"overlap": 0.25, "T_match_query": np.eye(4).tolist()}], "note": "geprüft"},
    ],
)
def test_evidence_of_any_other_shape_is_kept_as_it_is(changed):
    known = measured(**changed)
    assert read_back(known) == known


def test_evidence_that_was_stored_as_json_is_read():
    known = measured()
    assert PackedEvidence().process_result_value(json.dumps(known).encode(), DIALECT) == known
