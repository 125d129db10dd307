"""The figures of an evaluation: recognition, poses, sizes and times."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from revisit.evaluation.calibration import CONFIDENCE, RATES, Threshold, calibrate, null_similarities
from revisit.evaluation.described_submaps import DescribedSubmap
from revisit.evaluation.matching import QueryMatches, pose_error
from revisit.evaluation.metrics import (
    Flags,
    Outcomes,
    RecognitionScores,
    loop_segments,
    recall_at,
    score_recognition,
)

_BYTES_PER_RAW_POINT = 12


def summarise(places: Sequence[DescribedSubmap], matches: Sequence[QueryMatches], positives: Flags) -> dict[str, Any]:
    """All figures, JSON-ready. positives (n, n): whether the earlier submap, second, is a loop of the first.

    Counts, `descriptor` (cosine alone), `thresholds`, `verified`, `poses`, `seconds`, `bytes`.
    """
    by_similarity = [[match.id for match in query.by_similarity] for query in matches]
    by_score = [[candidate.id for candidate in query.ranked] for query in matches]
    cosine = [query.by_similarity[0].similarity if query.by_similarity else -np.inf for query in matches]
    score = [query.ranked[0].score if query.ranked else -np.inf for query in matches]
    return {
        "submaps": len(places),
        "failures": dict(Counter(place.failure.split(":")[0] for place in places if place.failure)),
        "bad_scans": len({scan for place in places for scan in place.bad_scans}),
        "queries_with_a_loop": int(positives.any(axis=1).sum()),
        "descriptor": _recognition(by_similarity, cosine, positives),
        "thresholds": _thresholds(places),
        "verified": {**_recognition(by_score, score, positives), **_accepted(matches, positives)},
        "rejections": dict(Counter(query.ranked[0].verdict.reason for query in matches if _rejected(query))),
        "poses": _pose_errors(places, matches),
        "seconds": _seconds(places, matches),
        "bytes": _bytes(places),
    }


def _recognition(ranked: list[list[int]], score: list[float], positives: Flags) -> dict[str, Any]:
    """The paper's figures of the first candidates, and recall@1/5."""
    correct = np.array([bool(ids) and bool(positives[query, ids[0]]) for query, ids in enumerate(ranked)], dtype=bool)
    has_loop = np.asarray(positives.any(axis=1))
    outcomes = Outcomes(np.array(score, dtype=np.float64), correct, has_loop)
    scores: RecognitionScores = score_recognition(outcomes, loop_segments(has_loop))
    return {
        **dataclasses.asdict(scores),
        "recall_at_1": recall_at(ranked, positives, 1),
        "recall_at_5": recall_at(ranked, positives, 5),
    }


def _thresholds(places: Sequence[DescribedSubmap]) -> dict[str, Any]:
    """`min_similarity` that holds each false-alarm rate in this place, without labels; None where it is too small."""
    described = [(place.description.vector, place.position) for place in places if place.description is not None]
    if not described:
        return {"distinct_places": 0, "confidence": CONFIDENCE, "min_similarity": {}}
    null = null_similarities(*(np.stack(column) for column in zip(*described, strict=True)))
    found = {f"{rate:.0%}": calibrate(null, rate) for rate in RATES}
    return {
        "distinct_places": null.distinct_places,
        "confidence": CONFIDENCE,
        "min_similarity": {
            rate: threshold.similarity if isinstance(threshold, Threshold) else None
            for rate, threshold in found.items()
        },
    }


def _rejected(query: QueryMatches) -> bool:
    return bool(query.ranked) and not query.ranked[0].verdict.accepted


def _accepted(matches: Sequence[QueryMatches], positives: Flags) -> dict[str, int]:
    """Loops the gates let through, by whether the submaps lie within the positive radius.

    Far ones need not be false: `poses` tells, by the error of their poses.
    """
    near = [
        bool(positives[index, query.ranked[0].id])
        for index, query in enumerate(matches)
        if query.ranked and query.ranked[0].verdict.accepted
    ]
    return {"accepted": len(near), "accepted_near": sum(near), "accepted_far": len(near) - sum(near)}


def _pose_errors(places: Sequence[DescribedSubmap], matches: Sequence[QueryMatches]) -> dict[str, Any]:
    """Errors of inv(T_estimated) T_true over all accepted loops, true poses from the recording.

    `false` counts poses that are off by more than 2 m or 5 degrees: a loop between submaps farther apart than the
    protocol's radius is wrong there, yet its pose may be right.
    """
    errors = []
    for index, query in enumerate(matches):
        best = query.ranked[0] if query.ranked else None
        if best is not None and best.T_match_query is not None and best.verdict.accepted:
            errors.append(pose_error(places[index], places[best.id], best.T_match_query))
    if not errors:
        return {"loops": 0, "false": 0}
    m, d = np.array(errors).T
    return {
        "loops": len(errors),
        "false": int(np.sum((m > 2.0) | (d > 5.0))),
        "median_m": float(np.median(m)), "p95_m": float(np.percentile(m, 95)), "max_m": float(m.max()),
        "median_deg": float(np.median(d)), "p95_deg": float(np.percentile(d, 95)), "max_deg": float(d.max()),
        "success_2m_5deg": float(np.mean((m <= 2.0) & (d <= 5.0))),
        "success_0.5m_1deg": float(np.mean((m <= 0.5) & (d <= 1.0))),
    }  # fmt: skip


def _seconds(places: Sequence[DescribedSubmap], matches: Sequence[QueryMatches]) -> dict[str, Any]:
    """Median seconds a submap: reading, describing, each stage of it, verifying all candidates of a query."""
    stages: dict[str, list[float]] = {}
    for place in places:
        for stage, seconds in (place.description.seconds if place.description else {}).items():
            stages.setdefault(stage, []).append(seconds)
    with_candidates = [query.seconds for query in matches if query.ranked]
    return {
        "load": _median([place.seconds["load"] for place in places]),
        "describe": _median([place.seconds["describe"] for place in places]),
        "stages": {stage: _median(seconds) for stage, seconds in stages.items()},
        "verify": _median(with_candidates),
    }


def _bytes(places: Sequence[DescribedSubmap]) -> dict[str, float | None]:
    """Mean bytes a submap: raw float32 points, neural map and signature, and their shares of the raw points."""
    described = [(place.description, place.points) for place in places if place.description is not None]
    if not described:
        return dict.fromkeys(("raw_float32", "neural_map", "signature", "descriptor", "neural_map_share"))
    raw = float(np.mean([points * _BYTES_PER_RAW_POINT for _, points in described]))
    neural = float(np.mean([description.neural_map_bytes for description, _ in described]))
    return {
        "raw_float32": raw,
        "neural_map": neural,
        "signature": float(np.mean([len(description.place) for description, _ in described])),
        "descriptor": float(np.mean([description.vector.nbytes for description, _ in described])),
        "neural_map_share": neural / raw,
    }


def _median(values: list[float]) -> float | None:
    return float(np.median(values)) if values else None
