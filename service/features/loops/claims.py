"""Loop closures as rows and as claims: the one place that turns one into the other.

A claim is of `core.acceptance`. Its row has state, reason, score and pose in columns; the rest is `evidence`, JSON:
`measurement`, `thresholds`, `doubts`, `support`, `distinctiveness`.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from revisit.core.acceptance import (
    TELLING,
    Doubt,
    Drive,
    Grounds,
    LoopClaim,
    Station,
    Support,
    stride_of_drive,
    submaps_asked,
)
from revisit.core.config import PipelineConfig, VerificationConfig
from revisit.core.geometry.se3 import Matrix4, pose_matrix
from revisit.core.pair_verdict import (
    Hypothesis,
    LoopMeasurement,
    PairVerdict,
    RejectedLoop,
    RejectionReason,
    VerifiedLoop,
)
from revisit.core.pose_graph.graph import GraphState
from revisit.core.radio import RadioFingerprint
from revisit.service.domain.records import LoopRecord, SubmapRecord
from revisit.service.domain.states import LoopState
from revisit.service.ports.transactions import UnitOfWork

Evidence = dict[str, Any]

SETTABLE = ("min_score", "min_overlap", "max_seen_through")
"""The thresholds that an operator may set (see `contract.loop_policy`): written beside each verdict."""

BRIEF = (
    "inliers", "overlap", "contrast", "seen_through", "rmse_m", "common_share", "enough_share", "covariance",
)  # fmt: skip
"""The measurement of a rejected pair that people and clients are told. Its pose, score and similarity are members of
the loop itself; the covariance counts where a person accepts it all the same."""

VERSION_DIGITS = 12

_RULES = ("thresholds", "thresholds_version")

_JUDGED = ("doubts", "support")
"""Members of the evidence of a stored loop that a new judgement replaces as a whole."""

_OF_PASSED_PAIRS = RejectionReason.AMBIGUOUS, RejectionReason.AWAITS_CHAIN
"""Reasons of pairs that passed every check by themselves, if doubts say why they are no loops."""

_WITNESSES = "on_earth", "own_odometry"
"""Members of a support that other loops do not give."""

_MOST_MATCHES = 1000


@dataclass(frozen=True)
class StoredDrive:
    """The drive before a submap, as the rules ask for it, and the row and submaps of each of its claims.

    `unsearched`: submaps of it with loops that are still searched for.
    """

    drive: Drive
    loops: list[LoopRecord]
    pairs: list[tuple[SubmapRecord, SubmapRecord]]
    unsearched: list[SubmapRecord]


def station(submap: SubmapRecord) -> Station:
    """A submap on its drive."""
    radio = None if submap.radio is None else RadioFingerprint.of_bytes(submap.radio)
    return Station(submap.session_number, submap.ordinal, pose_matrix(submap.T_odom_submap), radio)


def drive_before(uow: UnitOfWork, submap: SubmapRecord, config: PipelineConfig) -> StoredDrive:
    """The drive of `submap` before it, as far as the rules ask: the loops of submaps that entered before it, too."""
    path = uow.submaps.path(
        submap.tenant, submap.map_id, submap.session_id, submap.ordinal, submaps_asked(config), back=True
    )
    before = uow.submaps.numbered(submap.tenant, [one.number for one in path])
    queries = {number: one for number, one in before.items() if one.entered < submap.entered}
    stored = uow.loops.telling(submap.tenant, sorted(queries), [reason.value for reason in TELLING])
    loops = [loop for loop in stored if _says(loop)]
    matches = uow.submaps.numbered(submap.tenant, sorted({loop.match_number for loop in loops})[-_MOST_MATCHES:])
    loops = [loop for loop in loops if loop.match_number in matches]
    pairs = [(queries[loop.query_number], matches[loop.match_number]) for loop in loops]
    claims = [claim_of_row(loop, *pair) for loop, pair in zip(loops, pairs, strict=True)]
    stride_m = stride_of_drive(station(submap), [station(one) for one in before.values()], config)
    unsearched = [one for one in queries.values() if not one.searched]
    return StoredDrive(Drive(claims, stride_m), loops, pairs, unsearched)


def _says(loop: LoopRecord) -> bool:
    """Whether a stored loop says anything of a pose: accepted and no outlier, or of a reason that tells."""
    if loop.T_match_query is None:
        return False
    if loop.state == LoopState.ACCEPTED:
        return loop.graph_state != GraphState.SET_ASIDE
    return loop.reason in TELLING


def claim_of_row(loop: LoopRecord, query: SubmapRecord, match: SubmapRecord) -> LoopClaim:
    """A stored loop with a pose as a claim. A loop that a person accepted is not doubted any more."""
    support = _support_from(loop.evidence.get("support"))
    doubts = {Doubt(name): _grounds_from(stored) for name, stored in loop.evidence.get("doubts", {}).items()}
    accepted = loop.state == LoopState.ACCEPTED
    if accepted and (support is None or not support.is_help):
        doubts = {}
    verdict: PairVerdict
    if accepted or (doubts and loop.reason in _OF_PASSED_PAIRS):
        verdict = VerifiedLoop(_measurement_from(loop))
    else:
        verdict = RejectedLoop(RejectionReason(str(loop.reason)), _measurement_from(loop))
    return LoopClaim(station(query), station(match), verdict, doubts, support, by_hand=loop.manual)


def poses_of(loop: LoopRecord) -> tuple[Matrix4, ...]:
    """The poses T_match_query (4, 4) of a stored loop that has one: its own, the rivals, and those ruled out."""
    measured, support = _measurement_from(loop), _support_from(loop.evidence.get("support"))
    ruled_out = () if support is None else support.ruled_out
    return (measured.T_match_query, *(rival.T_match_query for rival in measured.rivals), *ruled_out)


def is_by_anchors(loop: LoopRecord) -> bool:
    """Whether anchors chose the pose of a stored loop (docs/decisions/0362)."""
    support = loop.evidence.get("support")
    return support is not None and bool(support.get("on_earth") or support.get("tags"))


def loop_state(claim: LoopClaim) -> LoopState:
    """The state of the row of a claim."""
    if claim.waits:
        return LoopState.PROPOSED
    return LoopState.ACCEPTED if claim.accepted else LoopState.REJECTED


def evidence_of(claim: LoopClaim, rules: VerificationConfig) -> Evidence:
    """The evidence of a claim that was verified by `rules`."""
    return {**verdict_evidence(claim.verdict, rules), **_judgement(claim)}


def kept_evidence(claim: LoopClaim, rules: VerificationConfig) -> Evidence:
    """As `evidence_of`; in brief where a pair was rejected for a reason that no rule reads (docs/decisions/0091)."""
    evidence = evidence_of(claim, rules)
    if claim.tells:
        return evidence
    measured = evidence["measurement"]
    return {**evidence, "measurement": {name: measured[name] for name in BRIEF if name in measured}}


def revised_evidence(stored: Evidence, claim: LoopClaim, rules: VerificationConfig) -> Evidence:
    """The evidence of a stored loop that was judged again: the pair has a new verdict only where it has support."""
    measured = verdict_evidence(claim.verdict, rules)
    if claim.support is None:
        measured = {name: value for name, value in measured.items() if name not in _RULES}
    return {**unjudged(stored), **measured, **_judgement(claim)}


def unjudged(stored: Evidence) -> Evidence:
    """The evidence of a stored loop without its former judgement."""
    return {name: value for name, value in stored.items() if name not in _JUDGED}


def evidence_without_waiting(stored: Evidence) -> Evidence:
    """The evidence of a stored loop that waited for its chain, once that has decided for it."""
    doubts = {name: grounds for name, grounds in stored["doubts"].items() if name != Doubt.AWAITS_CHAIN}
    kept = {name: value for name, value in stored.items() if name != "doubts"}
    return {**kept, "doubts": doubts} if doubts else kept


def verdict_evidence(verdict: PairVerdict, rules: VerificationConfig) -> Evidence:
    """The evidence of a pair by itself: its measurement, and the rules that judged it."""
    measured = {} if verdict.measurement is None else _as_json(verdict.measurement)
    message = verdict.message if isinstance(verdict, RejectedLoop) else None
    evidence: Evidence = {} if message is None else {"message": message}
    return {"measurement": measured, **evidence, **_thresholds(rules)}


def stored_verdict(verdict: PairVerdict) -> Evidence:
    """A verdict as JSON from which `verdict_of` makes the same one, to a bit; of a rejected pair only the reason."""
    if isinstance(verdict, RejectedLoop):
        return {"reason": verdict.reason.value, "message": verdict.message}
    return {"measurement": _as_json(verdict.measurement)}


def verdict_of(stored: Evidence) -> PairVerdict:
    """The verdict of `stored_verdict`."""
    if "measurement" not in stored:
        return RejectedLoop(RejectionReason(stored["reason"]), message=stored["message"])
    measured: Evidence = {name: np.nan if one is None else one for name, one in stored["measurement"].items()}
    rivals = tuple(Hypothesis(one["overlap"], np.array(one["T_match_query"])) for one in measured.pop("rivals"))
    for name in ("T_match_query", "covariance"):
        measured[name] = np.array(measured[name], dtype=np.float64)
    return VerifiedLoop(LoopMeasurement(**measured, rivals=rivals))


def rules_of(evidence: Evidence) -> Evidence:
    """The thresholds that a verdict was given by, of its evidence."""
    return {name: evidence[name] for name in _RULES if name in evidence}


def _judgement(claim: LoopClaim) -> Evidence:
    evidence: Evidence = {}
    if claim.doubts:
        evidence["doubts"] = {doubt.value: {"words": of.words, **of.figures} for doubt, of in claim.doubts.items()}
    if claim.support is not None:
        evidence["support"] = support_evidence(claim.support)
    if claim.distinctiveness is not None:
        evidence["distinctiveness"] = dataclasses.asdict(claim.distinctiveness)
    return evidence


def support_evidence(support: Support) -> Evidence:
    """A support as a member of the evidence."""
    return {
        "anchors": support.anchors,
        "agreeing": support.agreeing,
        "along_m": round(support.along_m, 3),
        "ruled_out": [pose.tolist() for pose in support.ruled_out],
        "words": support.words,
        **{name: True for name in _WITNESSES if getattr(support, name)},
        **({"tags": [*support.tags]} if support.tags else {}),
    }


def _support_from(stored: Evidence | None) -> Support | None:
    if stored is None:
        return None
    counts = stored["anchors"], stored["agreeing"], stored["along_m"]
    witnesses = {name: stored.get(name, False) for name in _WITNESSES}
    return Support(*counts, tuple(_poses(stored["ruled_out"])), **witnesses, tags=tuple(stored.get("tags", ())))


def _grounds_from(stored: Evidence) -> Grounds:
    return Grounds(stored["words"], {name: value for name, value in stored.items() if name != "words"})


def _measurement_from(loop: LoopRecord) -> LoopMeasurement:
    """The measurement of a stored loop that has a pose. A person's loop has the pose alone."""
    stored = loop.evidence.get("measurement", {})
    return LoopMeasurement(
        similarity=loop.similarity,
        inliers=int(stored.get("inliers") or 0),
        inlier_ratio=_number(stored, "inlier_ratio"),
        overlap=_number(stored, "overlap"),
        contrast=_number(stored, "contrast"),
        seen_through=_number(stored, "seen_through"),
        rmse_m=_number(stored, "rmse_m"),
        score=loop.score,
        T_match_query=pose_matrix(loop.T_match_query) if loop.T_match_query else np.eye(4),
        covariance=np.nan_to_num(np.array(stored.get("covariance", np.zeros(36)), dtype=np.float64)).reshape(6, 6),
        rivals=tuple(Hypothesis(*_hypothesis(one)) for one in stored.get("rivals", ())),
        common_share=_number(stored, "common_share"),
        enough_share=_number(stored, "enough_share"),
    )


def _number(stored: Evidence, name: str) -> float:
    return float(stored.get(name) or 0.0)


def _hypothesis(stored: Evidence) -> tuple[float, Matrix4]:
    return float(stored["overlap"] or 0.0), np.array(stored["T_match_query"], dtype=np.float64)


def _poses(stored: Sequence[Any]) -> list[Matrix4]:
    return [np.array(pose, dtype=np.float64) for pose in stored]


@lru_cache(maxsize=64)
def _thresholds(rules: VerificationConfig) -> Evidence:
    """Which rules gave the verdict: those that an operator sets, others that are not the default, and a hash of all.

    Kept, because each candidate of a map has the same ones; nobody changes the answer.
    """
    values, defaults = _as_json(rules), _as_json(VerificationConfig())
    stored = {name: value for name, value in values.items() if name in SETTABLE or value != defaults[name]}
    digest = hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
    return {"thresholds": stored, "thresholds_version": digest[:VERSION_DIGITS]}


def _as_json(record: Any) -> Evidence:
    """The fields of a flat dataclass of numbers, strings and arrays; a non-finite number becomes None."""
    return {field.name: _json_value(getattr(record, field.name)) for field in dataclasses.fields(record)}


def _json_value(value: Any) -> Any:
    if isinstance(value, Hypothesis):
        return _as_json(value)
    if isinstance(value, np.ndarray):
        numbers = value.tolist()
        return numbers if np.isfinite(value).all() else [_json_value(item) for item in numbers]
    if isinstance(value, list | tuple):
        return [_json_value(item) for item in value]
    if isinstance(value, np.generic):
        return _json_value(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
