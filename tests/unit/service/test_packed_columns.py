"""Poses and brief evidence as a database holds them: small, and read back as they were written."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from revisit.service.engines.sql.packed_columns import PackedEvidence, PackedPose, packed_brief, unpacked_brief

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
