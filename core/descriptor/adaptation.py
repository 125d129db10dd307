"""Descriptors standardised by the places of their own map, without labels (docs/decisions/0120).

Streets of one town look alike, and so do all scans of one sensor: what the descriptors of a map have in common says
nothing about which place is which. Each is therefore taken relative to the mean of its session, every entry divided by
its spread over the map.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import AdaptationConfig

Array = NDArray[np.float32]

_SHORTEST = 1e-6
"""A descriptor that differs less from its mean, in spreads, is compared as it is."""


@dataclass(frozen=True)
class SiteStatistics:
    """Statistics of the descriptors (n, d) of a map: `mean` and `spread` (d,), and the mean (d,) of sessions."""

    mean: Array
    spread: Array
    session_means: dict[int, Array] = field(default_factory=dict)

    def adapted(self, vectors: Array, sessions: NDArray[np.int64]) -> Array:
        """Unit vectors (n, d) of descriptors (n, d) of the given sessions (n,); the map's mean stands in for others'.

        Row by row: the answer does not depend on which rows are adapted together. A descriptor that equals its mean
        stays as it is.
        """
        # In place: a search adapts a megabyte, and a new array of that size costs as much as the sum in it.
        adapted = self._means_of(sessions)
        np.subtract(vectors, adapted, out=adapted)
        adapted /= self.spread
        lengths = np.sqrt(np.einsum("ij,ij->i", adapted, adapted))
        if not (usable := lengths > _SHORTEST).all():
            adapted[~usable], lengths[~usable] = vectors[~usable], 1.0
        adapted /= lengths[:, None]
        return adapted

    def cosines(self, vectors: Array, sessions: NDArray[np.int64], query: Array) -> Array:
        """The cosine (n,) of each of descriptors (n, d), `adapted` to its session (n,), with a unit `query` (d,)."""
        from revisit.core.kernels.adapted_cosines import adapted_cosines  # and its compiler, only to compute

        means, which = self._distinct_means(sessions)
        return adapted_cosines(vectors, means, which, self.spread, query, _SHORTEST)

    def _means_of(self, sessions: NDArray[np.int64]) -> Array:
        """The mean (n, d) for each of the sessions (n,), a new array."""
        if len(sessions) == 1:  # a query
            return np.array(self.session_means.get(int(sessions[0]), self.mean)[None])
        means, which = self._distinct_means(sessions)
        return np.take(means, which, axis=0)

    def _distinct_means(self, sessions: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
        """The means (m, d) of the sessions that there are, and which of them is that of each of the sessions (n,)."""
        names, which = np.unique(sessions, return_inverse=True)
        return np.stack([self.session_means.get(name, self.mean) for name in names.tolist()] or [self.mean]), which

    def with_sessions(self, seen: Mapping[int, SessionSums]) -> SiteStatistics:
        """The statistics with the mean of each session in `seen`."""
        means = {session: sums.mean(drawn_to=self.mean) for session, sums in seen.items()}
        return SiteStatistics(self.mean, self.spread, {**self.session_means, **means})


@dataclass(frozen=True)
class SessionSums:
    """Sums of a session's descriptors: their number, their sum (d,) and the sum of their squares (d,)."""

    count: int
    total: NDArray[np.float64]
    squares: NDArray[np.float64]

    @staticmethod
    def of(vectors: Array) -> SessionSums:
        """Of descriptors (m, d)."""
        exact = vectors.astype(np.float64)
        return SessionSums(len(vectors), exact.sum(axis=0), np.einsum("ij,ij->j", exact, exact))

    def mean(self, drawn_to: Array) -> Array:
        """The mean (d,), drawn to the mean (d,) of the map as far as chance explains their difference.

        A session that saw only some of the map's places differs from the map by those; one of another sensor differs by
        more. The positive-part estimator of James and Stein: the difference counts by 1 - (its expected square by
        chance) / (its square), at least 0.
        """
        if self.count < 2:
            return drawn_to
        own = self.total / self.count
        by_chance = float(self.scatter(own).sum()) / (self.count - 1) / self.count
        difference = own - drawn_to
        share = max(0.0, 1.0 - by_chance / max(float(np.square(difference).sum()), 1e-12))
        return np.asarray(drawn_to + share * difference, dtype=np.float32)

    def scatter(self, centre: NDArray[np.floating]) -> NDArray[np.float64]:
        """The sum (d,) of squared differences from `centre` (d,)."""
        about = self.squares - 2.0 * centre * self.total + self.count * np.square(centre, dtype=np.float64)
        return np.asarray(np.maximum(about, 0.0))


def learn_site(sessions: Mapping[int, SessionSums], config: AdaptationConfig) -> SiteStatistics:
    """Statistics of the descriptors of a map by session, without the means of single sessions.

    The mean is drawn to zero, the spread about the sessions' means to that of a random unit vector, each as if
    `prior_places` such places had been seen, too. So a map of a few places hardly adapts.
    """
    seen = [sessions[session] for session in sorted(sessions)]
    size, total = len(seen[0].total), sum(sums.count for sums in seen) + config.prior_places
    mean = np.asarray(sum(sums.total for sums in seen) / total, dtype=np.float32)
    squares = sum((sums.scatter(sums.mean(mean)) for sums in seen), np.full(size, config.prior_places / size))
    spread = np.sqrt(squares / total)
    return SiteStatistics(mean, (spread + config.spread_floor * spread.mean()).astype(np.float32))


def by_session(sessions: NDArray[np.int64]) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """Each of the `sessions` (n,) with its rows in order."""
    order = np.argsort(sessions, kind="stable")
    names, starts = np.unique(sessions[order], return_index=True)
    return zip(names.tolist(), np.split(order, starts)[1:], strict=True)


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
