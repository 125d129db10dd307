"""Loops that anchors speak against: two places that look alike, and lie far apart on earth.

Where places are exact twins, geometry cannot tell them apart; a fix on earth can. A loop says how far apart the anchors
beside its two submaps must lie; it is refuted where they lie farther apart, by more than receivers err
(docs/decisions/0357).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.geometry.path import travelled_m
from revisit.core.pose_graph.anchors import Anchor
from revisit.core.pose_graph.graph import LoopEdge, Node

Array64 = NDArray[np.float64]

BESIDE_M = 60.0
"""Anchors so far along the drive from a submap tell where it is; odometry bends little on such a way."""

EACH_M = 5.0
"""One anchor in so many metres of the drive counts: reflections of 30 s are few beside a slow robot, too."""

TOGETHER_M = 20.0
"""An anchor is compared with the one of the other drive that a loop puts nearest to it, if so near."""

LEAST_BESIDE = 3
"""Anchors on each side, at least: one or two may be tags that were misread."""

LEAST_SHARE = 0.8
"""Of the anchors beside both submaps must say the same."""

SIGMAS = 4.0
"""So many standard deviations of both places are no contradiction."""

FAR_M = 100.0
"""No receiver errs by so much more than it states, and few datums lie so far apart."""

APART_M, NEAR_M, LEAST_NEAR = 45.0, 25.0, 3
"""Between drives whose anchors lie within NEAR_M of each other by so many loops, receivers agree, as one does with
itself. There reflections alone make a difference, and hardly one is of more than APART_M beyond what is stated."""

OWN_M, OWN_SHARE, STRETCH_M = 10.0, 0.7, 150.0
"""So many of the anchors STRETCH_M before and behind a place of a drive lie where its odometry has them, but for OWN_M
beyond what is stated. Where not, a clock is wrong, or reflections are many: such a drive refutes nothing."""

STRETCHES, FITTINGS = 50, 3
"""Places of a drive, at most, beside which it is looked at; and how often the best of the anchors are chosen."""

ANOTHER_SITE_M = 100_000.0
"""A place so far away is none: receivers tell (0, 0) before they have a fix."""


@dataclass(frozen=True)
class _AnchoredDrive:
    """A drive with its anchors in the order in which it passes them.

    T_odom_submap (n, 4, 4); along_m (n,) of its submaps. Of the anchors: anchor_along_m (k,), points_odom (k, 3),
    places (k, 2) across the ground and sigmas_m (k,).
    """

    T_odom_submap: Array64
    along_m: Array64
    anchor_along_m: Array64
    points_odom: Array64
    places: Array64
    sigmas_m: Array64

    @classmethod
    def of(cls, T_odom_submap: Array64, anchors: Sequence[Anchor]) -> _AnchoredDrive:
        """A drive with at least one anchor."""
        along_m = travelled_m(T_odom_submap[:, :3, 3])
        ordinals = np.array([one.node.ordinal for one in anchors])
        T = T_odom_submap[ordinals]
        ahead = np.einsum("nij,nj->ni", T[:, :3, :3], np.array([one.point_submap for one in anchors]))
        anchor_along_m = along_m[ordinals] + (ahead * _directions(T_odom_submap)[ordinals]).sum(axis=1)
        order = np.argsort(anchor_along_m, kind="stable")
        variances = np.linalg.eigvalsh(np.array([one.covariance[:2, :2] for one in anchors]))[:, -1]
        return cls(
            T_odom_submap,
            along_m,
            anchor_along_m[order],
            (ahead + T[:, :3, 3])[order],
            np.array([one.place_world[:2] for one in anchors])[order],
            np.sqrt(variances)[order],
        )

    def beside(self, ordinal: int) -> tuple[Array64, Array64, Array64]:
        """Of the anchors beside a submap: points (k, 3) in its frame, places (k, 2) and standard deviations (k,)."""
        rows = self._rows(self.along_m[ordinal], BESIDE_M)
        points = se3.apply(se3.inverse(self.T_odom_submap[ordinal]), self.points_odom[rows])
        return points, self.places[rows], self.sigmas_m[rows]

    @cached_property
    def fits(self) -> bool:
        """Whether the anchors lie, along most stretches of the drive, as its odometry has them."""
        n = len(self.anchor_along_m)
        some = self.anchor_along_m[np.unique(np.linspace(0, n - 1, min(n, STRETCHES)).round().astype(np.int64))]
        stretches = [rows for along_m in some if len(rows := self._rows(along_m, STRETCH_M)) > LEAST_BESIDE]
        return bool(np.mean([self._is_as_driven(rows) for rows in stretches] or [True]) >= LEAST_SHARE)

    def _rows(self, along_m: float, reach_m: float) -> NDArray[np.int64]:
        """The anchors that count within reach of a place of the drive, in its order."""
        first, last = np.searchsorted(self.anchor_along_m, (along_m - reach_m, along_m + reach_m))
        parts = (self.anchor_along_m[first:last] - along_m) // EACH_M
        return np.asarray(first + np.flatnonzero(np.diff(parts, prepend=-np.inf)))

    def _is_as_driven(self, rows: NDArray[np.int64]) -> bool:
        """Whether most of some anchors lie where the odometry has them, moved and turned on the ground as fits best."""
        driven, told = (values[rows, :2] @ (1.0, 1.0j) for values in (self.points_odom, self.places))
        best = np.ones(len(rows), dtype=np.bool_)
        for _ in range(FITTINGS):
            a, b = driven - driven[best].mean(), told - told[best].mean()
            off_m = np.abs(b - a * np.exp(1j * np.angle(np.vdot(a[best], b[best]))))
            best = off_m <= np.quantile(off_m, OWN_SHARE)
        return bool((off_m < OWN_M + SIGMAS * self.sigmas_m[rows]).mean() >= OWN_SHARE)


def refuted_by_anchors(
    T_odom_submap: Mapping[str, Array64], loops: Sequence[LoopEdge], anchors: Sequence[Anchor]
) -> set[str]:
    """The names of the loops that anchors speak against. T_odom_submap (n, 4, 4): the drive of each session.

    Nothing but the loop, its drives and their anchors counts; of all loops between two drives it counts how many their
    anchors agree with.
    """
    of_session: dict[str, list[Anchor]] = {}
    for anchor in anchors:
        of_session.setdefault(anchor.node.session, []).append(anchor)
    drives = {name: _AnchoredDrive.of(T_odom_submap[name], its) for name, its in of_session.items()}
    excess = {
        loop.name: _excess_m(drives[loop.match.session], drives[loop.query.session], loop)
        for loop in loops
        if loop.match.session in drives and loop.query.session in drives
    }
    pairs = {loop.name: frozenset((loop.match.session, loop.query.session)) for loop in loops}
    near: dict[frozenset[str], set[Node]] = {}
    for loop in loops:
        if _most(excess.get(loop.name), below=NEAR_M):
            near.setdefault(pairs[loop.name], set()).add(loop.query)
    agree = {pair for pair, queries in near.items() if len(queries) >= LEAST_NEAR}
    return {
        name
        for name, its in excess.items()
        if _most(its, above=APART_M if len(pairs[name]) == 1 or pairs[name] in agree else FAR_M)
        and all(drives[one].fits for one in pairs[name])
    }


def _excess_m(match: _AnchoredDrive, query: _AnchoredDrive, loop: LoopEdge) -> Array64 | None:
    """How much farther apart anchors (n,) of two drives lie than a loop says, less what their errors explain.

    Each with the nearest of the other drive; None where too few lie beside it.
    """
    points, places, sigmas = match.beside(loop.match.ordinal)
    others, other_places, other_sigmas = query.beside(loop.query.ordinal)
    if min(len(points), len(others)) < LEAST_BESIDE:
        return None
    told_m = np.linalg.norm(points[:, None] - se3.apply(loop.T_match_query, others)[None], axis=2)
    rows = np.concatenate([np.arange(len(points)), told_m.argmin(axis=0)])
    columns = np.concatenate([told_m.argmin(axis=1), np.arange(len(others))])
    apart_m = np.linalg.norm(places[rows] - other_places[columns], axis=1)
    compared = (told_m[rows, columns] <= TOGETHER_M) & (apart_m < ANOTHER_SITE_M)
    if min(len({*rows[compared]}), len({*columns[compared]})) < LEAST_BESIDE:
        return None
    errors_m = SIGMAS * np.hypot(sigmas[rows], other_sigmas[columns])
    return np.asarray((apart_m - told_m[rows, columns] - errors_m)[compared])


def _directions(T_odom_submap: Array64) -> Array64:
    """Unit vectors (n, 3) in which a drive goes on at its submaps; zero where it stands."""
    places = T_odom_submap[:, :3, 3]
    steps = np.gradient(places, axis=0) if len(places) > 1 else np.zeros_like(places)
    return np.asarray(steps / np.maximum(np.linalg.norm(steps, axis=1), 1e-9)[:, None])


def _most(excess_m: Array64 | None, above: float = -np.inf, below: float = np.inf) -> bool:
    """Whether most anchors lie within these bounds; none say nothing."""
    return excess_m is not None and bool(((excess_m > above) & (excess_m < below)).mean() >= LEAST_SHARE)
