"""How good a list of matches is: the paper's precision, recall, AUC and F1 (IV-B), and further figures for users.

The paper's protocol. A query's loop exists where an earlier submap lies within the radius and differs by more than
the index gap. A match is accepted where its score reaches the threshold; accepted is right within the radius (TP),
else wrong (FP); a query not accepted is a miss (FN) where its loop exists, else right (TN). A wrong match is an FP
even where a loop exists, so recall tends to 1 as the threshold falls; `recall_over_loops` does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Outcomes:
    """One row a query.

    score (n,) of its match, -inf where there is none; correct (n,) whether the match is right; has_loop (n,) whether
    there was anything to find.
    """

    score: Floats
    correct: Flags
    has_loop: Flags

    def __post_init__(self) -> None:
        if not self.score.shape == self.correct.shape == self.has_loop.shape or self.score.ndim != 1:
            raise ValueError("score, correct and has_loop must be of one length")
        if np.isnan(self.score).any():
            raise ValueError("a score must not be NaN")

    def __len__(self) -> int:
        return len(self.score)

    def taken(self, rows: NDArray[np.int64]) -> Outcomes:
        """The outcomes of the given rows, repeated where a row is."""
        return Outcomes(self.score[rows], self.correct[rows], self.has_loop[rows])


@dataclass(frozen=True)
class PrecisionRecall:
    """Operating points by falling threshold, ties taken together.

    All (t,); recall as the paper counts it, recall_over_loops = TP over all queries with a loop.
    """

    threshold: Floats
    precision: Floats
    recall: Floats
    recall_over_loops: Floats


def precision_recall(outcomes: Outcomes) -> PrecisionRecall:
    """The curve of `outcomes`; empty where no query has a match."""
    matched = np.isfinite(outcomes.score)
    order = np.argsort(-outcomes.score[matched], kind="stable")
    score = outcomes.score[matched][order]
    correct, has_loop = outcomes.correct[matched][order], outcomes.has_loop[matched][order]
    last_of_tie = np.append(score[1:] != score[:-1], True) if len(score) else np.zeros(0, dtype=bool)
    true_positives = np.cumsum(correct)[last_of_tie]
    accepted = np.flatnonzero(last_of_tie) + 1
    loops = int(outcomes.has_loop.sum())
    missed = loops - np.cumsum(has_loop)[last_of_tie]
    return PrecisionRecall(
        threshold=score[last_of_tie],
        precision=true_positives / accepted,
        recall=true_positives / np.maximum(true_positives + missed, 1),
        recall_over_loops=true_positives / max(loops, 1),
    )


def area_under_curve(precision: Floats, recall: Floats) -> float:
    """Trapezoid over (recall, precision) in the order given, with (0, first precision) prepended; 0 without points."""
    if len(precision) == 0:
        return 0.0
    p, r = np.concatenate([precision[:1], precision]), np.concatenate([[0.0], recall])
    return float(np.sum((r[1:] - r[:-1]) * (p[1:] + p[:-1]) / 2.0))


def average_precision(curve: PrecisionRecall) -> float:
    """Sum of precision times the gain in recall over all queries with a loop."""
    gain = np.diff(np.concatenate([[0.0], curve.recall_over_loops]))
    return float(np.sum(gain * curve.precision))


def best_f1(curve: PrecisionRecall) -> tuple[float, float | None]:
    """The highest F1 (paper Eq. 16) and its threshold; (0, None) where nothing is right."""
    total = curve.precision + curve.recall
    f1 = np.divide(2 * curve.precision * curve.recall, total, out=np.zeros_like(total), where=total > 0)
    if len(f1) == 0 or f1.max() == 0.0:
        return 0.0, None
    best = int(f1.argmax())
    return float(f1[best]), float(curve.threshold[best])


def recall_at_full_precision(curve: PrecisionRecall) -> float:
    """The largest share of all loops found at a threshold without any wrong match."""
    clean = curve.recall_over_loops[curve.precision == 1.0]
    return float(clean.max()) if len(clean) else 0.0


def extended_precision(curve: PrecisionRecall) -> float:
    """(precision at the highest threshold + recall at 100 % precision) / 2 (Ferrarini et al. 2020)."""
    first = float(curve.precision[0]) if len(curve.precision) else 0.0
    return (first + recall_at_full_precision(curve)) / 2.0


@dataclass(frozen=True)
class Interval:
    """A figure with the 95 % interval of its bootstrap."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class RecognitionScores:
    """All figures of one method on one recording."""

    auc: Interval
    max_f1: Interval
    max_f1_threshold: float | None
    average_precision: float
    recall_over_loops: float
    recall_at_full_precision: float
    extended_precision: float
    queries: int
    matches: int
    loops: int


def score_recognition(
    outcomes: Outcomes, segments: NDArray[np.int64], *, draws: int = 200, seed: int = 0
) -> RecognitionScores:
    """Every figure of `outcomes`; intervals by drawing whole `segments` (n,) anew (`loop_segments`)."""
    curve = precision_recall(outcomes)
    f1, threshold = best_f1(curve)
    samples = _bootstrap(outcomes, segments, draws, seed)
    return RecognitionScores(
        auc=_interval(area_under_curve(curve.precision, curve.recall), samples[:, 0]),
        max_f1=_interval(f1, samples[:, 1]),
        max_f1_threshold=threshold,
        average_precision=average_precision(curve),
        recall_over_loops=float(curve.recall_over_loops[-1]) if len(curve.recall) else 0.0,
        recall_at_full_precision=recall_at_full_precision(curve),
        extended_precision=extended_precision(curve),
        queries=len(outcomes), matches=int(np.isfinite(outcomes.score).sum()), loops=int(outcomes.has_loop.sum()),
    )  # fmt: skip


def mean_auc(runs: Sequence[Outcomes], less: Sequence[Outcomes] | None = None, *, draws: int = 200) -> Interval:
    """The mean AUC over recordings, or how far it is above that of `less`, outcomes of the same queries.

    The interval is by bootstrap over loop segments; both methods meet the same draws, so that a difference is paired.
    """
    measured, drawn = _aucs(runs, draws)
    if less is not None:
        other, other_drawn = _aucs(less, draws)
        measured, drawn = measured - other, drawn - other_drawn
    return _interval(float(measured.mean()), drawn.mean(axis=0))


def _aucs(runs: Sequence[Outcomes], draws: int) -> tuple[Floats, Floats]:
    """AUC of each run (r,), and of its draws (r, d)."""
    curves = [precision_recall(run) for run in runs]
    measured = np.array([area_under_curve(curve.precision, curve.recall) for curve in curves])
    samples = [_bootstrap(run, loop_segments(run.has_loop), draws, seed)[:, 0] for seed, run in enumerate(runs)]
    shortest = min(len(sample) for sample in samples)
    return measured, np.stack([sample[:shortest] for sample in samples])


def loop_segments(has_loop: Flags, longest: int = 20) -> NDArray[np.int64]:
    """Segment numbers (n,) of neighbouring queries: a new one wherever queries begin or cease to have a loop.

    Neighbouring queries see the same place, so they are drawn together in the bootstrap. A segment ends after `longest`
    queries (100 m at the default stride): where all queries have a loop, one segment would leave nothing to draw.
    """
    numbers, current, start = np.zeros(len(has_loop), dtype=np.int64), 0, 0
    for query in range(1, len(has_loop)):
        if has_loop[query] != has_loop[query - 1] or query - start == longest:
            current, start = current + 1, query
        numbers[query] = current
    return numbers


def _bootstrap(outcomes: Outcomes, segments: NDArray[np.int64], draws: int, seed: int) -> Floats:
    """AUC and max F1 (at most draws, 2) of outcomes whose segments are drawn with replacement.

    Draws without any loop are left out: nothing could be found in them, so they have no AUC.
    """
    rng = np.random.default_rng([seed, 51])
    members = [np.flatnonzero(segments == segment) for segment in np.unique(segments)]
    results = []
    for _ in range(draws if members else 0):
        chosen = rng.integers(len(members), size=len(members))
        drawn = outcomes.taken(np.concatenate([members[index] for index in chosen]))
        if drawn.has_loop.any():
            curve = precision_recall(drawn)
            results.append((area_under_curve(curve.precision, curve.recall), best_f1(curve)[0]))
    return np.array(results).reshape(-1, 2)


def _interval(value: float, samples: Floats) -> Interval:
    if len(samples) == 0:
        return Interval(value, value, value)
    low, high = np.percentile(samples, [2.5, 97.5])
    return Interval(value, float(low), float(high))


@dataclass(frozen=True)
class LoopProtocol:
    """When two submaps of one session show the same place (paper IV-B)."""

    positive_radius_m: float = 20.0
    min_index_gap: int = 50


def positive_pairs(positions: Floats, protocol: LoopProtocol) -> Flags:
    """(n, n): entry [q, m] is true where the earlier submap m is a loop of submap q. positions (n, 3) metres."""
    distance = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    index = np.arange(len(positions))
    earlier = index[:, None] - index[None] > protocol.min_index_gap
    return np.asarray((distance <= protocol.positive_radius_m) & earlier)


def recall_at(ranked: list[list[int]], positives: Flags, k: int) -> float:
    """Share of the queries with a loop where one of the first `k` candidates is right. ranked[q]: ids, best first."""
    with_loop = np.flatnonzero(positives.any(axis=1))
    if len(with_loop) == 0:
        return 0.0
    found = [bool(positives[query, ranked[query][:k]].any()) if ranked[query] else False for query in with_loop]
    return float(np.mean(found))
