"""Descriptors standardised by the places of their own map, without labels (docs/decisions/0120).

Streets of one town look alike, and so do all scans of one sensor: what the descriptors of a map have in common says
nothing about which place is which. Each is therefore taken relative to the mean of its session, every entry divided by
its spread over the map.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import AdaptationConfig

Array = NDArray[np.float32]


@dataclass(frozen=True)
class SiteStatistics:
    """What the descriptors (n, d) of a map have in common: `mean` and `spread` (d,), and the mean (d,) of sessions."""

    mean: Array
    spread: Array
    session_means: dict[int, Array] = field(default_factory=dict)

    def adapted(self, vectors: Array, sessions: NDArray[np.int64]) -> Array:
        """Unit vectors (n, d) of descriptors (n, d) of the given sessions (n,); the map's mean stands in for others'.

        Row by row: the answer does not depend on which rows are adapted together. A descriptor that equals its mean
        stays as it is.
        """
        adapted = np.empty(vectors.shape, dtype=np.float32)
        for session in np.unique(sessions).tolist():
            rows = np.flatnonzero(sessions == session)
            adapted[rows] = (vectors[rows] - self.session_means.get(session, self.mean)) / self.spread
        lengths = np.sqrt(np.einsum("ij,ij->i", adapted, adapted))
        usable = lengths > 1e-6
        adapted[~usable] = vectors[~usable]
        adapted[usable] /= lengths[usable, None]
        return adapted

    def with_session(self, session: int, vectors: Array) -> SiteStatistics:
        """The statistics with the mean of `session` learned from its descriptors (m, d)."""
        return SiteStatistics(self.mean, self.spread, {**self.session_means, session: session_mean(vectors, self.mean)})


def session_mean(vectors: Array, mean: Array) -> Array:
    """The mean (d,) of a session's descriptors (m, d), drawn to the map's `mean` (d,) as far as chance explains it.

    A session that saw only some of the map's places differs from the map by those; one of another sensor differs by
    more. The positive-part estimator of James and Stein: the difference counts by 1 - (its expected square by chance) /
    (its square), at least 0.
    """
    if len(vectors) < 2:
        return mean
    own = vectors.mean(axis=0, dtype=np.float64)
    by_chance = float(np.square(vectors - own).sum()) / (len(vectors) - 1) / len(vectors)
    share = max(0.0, 1.0 - by_chance / max(float(np.square(own - mean).sum()), 1e-12))
    return np.asarray(mean + share * (own - mean), dtype=np.float32)


def learn_site(vectors: Array, sessions: NDArray[np.int64], config: AdaptationConfig) -> SiteStatistics:
    """Statistics of descriptors (n, d) of the given sessions (n,), without the means of single sessions.

    The mean is drawn to zero, the spread about the sessions' means to that of a random unit vector, each as if
    `prior_places` such places had been seen, too. So a map of a few places hardly adapts.
    """
    count, size = vectors.shape
    total = count + config.prior_places
    mean = np.asarray(vectors.sum(axis=0, dtype=np.float64) / total, dtype=np.float32)
    squares = np.full(size, config.prior_places / size)
    for session in np.unique(sessions).tolist():
        own = vectors[sessions == session]
        residuals = own - session_mean(own, mean)
        squares += np.einsum("ij,ij->j", residuals, residuals)
    spread = np.sqrt(squares / total)
    return SiteStatistics(mean, (spread + config.spread_floor * spread.mean()).astype(np.float32))


def learned_from(count: int, config: AdaptationConfig) -> int:
    """From how many of `count` places statistics are learned: 0, `first_places`, then steps of `growth`.

    So they change seldom, and do not depend on when one asks.
    """
    if count < config.first_places:
        return 0
    step = config.first_places
    while (larger := max(step + 1, int(step * config.growth))) <= count:
        step = larger
    return step
