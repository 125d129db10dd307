"""Thresholds without labels, from how alike places look that odometry puts far apart.

A recording's own submaps give the null distribution: the similarity of each place's best match among places that
cannot show the same thing. A threshold holds a false-alarm rate where enough distinct places lie below it; what is
promised is the order-statistic bound of Wilks (1941), so nothing is assumed of the shape of the tail.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from revisit.core.config import BevConfig

Floats = NDArray[np.float64]

RATES = (0.1, 0.05, 0.01)
"""False-alarm rates that evaluations ask for."""
CONFIDENCE = 0.95
FAR_M = 2.0 * BevConfig().half_range
"""Beyond this two bird's-eye images have nothing in common."""
DISTINCT_M = 20.0
"""Places nearer than this are one place (the paper's radius of a loop), hence one sample."""
DRIFT = 0.02
"""Metres that odometry may be wrong for each metre travelled between two places."""


@dataclass(frozen=True)
class NullSimilarities:
    """Highest similarity (n,) of each place to those far from it, and how many distinct places these n are."""

    similarity: Floats
    distinct_places: int


@dataclass(frozen=True)
class Threshold:
    """Accept pairs above `similarity`.

    With probability `confidence`, at most the share `false_alarm_rate` of the queries whose place is not in the map
    finds a match above it.
    """

    similarity: float
    false_alarm_rate: float
    confidence: float


@dataclass(frozen=True)
class TooFewPlaces:
    """No threshold can be named for the rate: it takes `needed` distinct places, and there are fewer."""

    distinct_places: int
    needed: int


def null_similarities(vectors: NDArray[np.float32], positions: Floats) -> NullSimilarities:
    """The best far match of every place, from odometry alone.

    vectors (n, d) of length 1 and positions (n, 3) metres, in the order they were driven. Two places are far apart
    where even a drift of `DRIFT` leaves more than `FAR_M` between them; a place without any far one is left out.
    """
    similarity = np.where(_far(positions), vectors @ vectors.T, -np.inf).max(axis=1, initial=-np.inf)
    used = np.isfinite(similarity)
    return NullSimilarities(similarity[used].astype(np.float64), count_distinct(positions[used], DISTINCT_M))


def calibrate(
    null: NullSimilarities, false_alarm_rate: float, confidence: float = CONFIDENCE
) -> Threshold | TooFewPlaces:
    """The lowest threshold that holds the rate with the confidence, both in (0, 1); TooFewPlaces where none does.

    The share of the null above the k-th highest of m independent samples is distributed as Beta(k, m - k + 1) whatever
    the null is. m counts distinct places; neighbouring submaps say where the quantile k / m lies, and no more.
    """
    if not (0.0 < false_alarm_rate < 1.0 and 0.0 < confidence < 1.0):
        raise ValueError(f"rate and confidence must lie in (0, 1), got {false_alarm_rate} and {confidence}")
    rank = allowed_rank(null.distinct_places, false_alarm_rate, confidence)
    if rank == 0:
        return TooFewPlaces(null.distinct_places, places_needed(false_alarm_rate, confidence))
    from_above = rank * len(null.similarity) // null.distinct_places
    return Threshold(float(np.sort(null.similarity)[-from_above]), false_alarm_rate, confidence)


def allowed_rank(samples: int, rate: float, confidence: float) -> int:
    """The greatest k where, with the confidence, at most `rate` of the null is above the k-th highest sample; or 0."""
    ranks = np.arange(1, samples + 1)
    return int(np.sum(binom.sf(ranks - 1, samples, rate) >= confidence))


def places_needed(rate: float, confidence: float) -> int:
    """The least m where the highest of m samples holds the rate: 1 - (1 - rate)^m >= confidence."""
    return int(np.ceil(np.log1p(-confidence) / np.log1p(-rate)))


def count_distinct(positions: Floats, apart_m: float) -> int:
    """How many of the positions (n, 3) remain where one within `apart_m` of an earlier that remains is dropped."""
    kept: list[Floats] = []
    for position in positions:
        if not kept or np.linalg.norm(np.array(kept) - position, axis=1).min() > apart_m:
            kept.append(position)
    return len(kept)


def _far(positions: Floats) -> NDArray[np.bool_]:
    """Which places (n, n) are far apart, drift allowed for."""
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(steps)])[: len(positions)]
    between = np.abs(travelled[:, None] - travelled[None])
    distance = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    return np.asarray(distance - DRIFT * between > FAR_M)
