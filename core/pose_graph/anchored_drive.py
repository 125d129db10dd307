"""A drive with its anchors in the order in which it passes them: where they put its submaps, and whether its odometry
says the same.
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

Array64 = NDArray[np.float64]

BESIDE_M = 60.0
"""Anchors so far along the drive from a submap tell where it is; odometry bends little on such a way."""

EACH_M = 5.0
"""One anchor in so many metres of the drive counts: reflections of 30 s are few beside a slow robot, too."""

LEAST_BESIDE = 3
"""Anchors on each side, at least: one or two may be tags that were misread."""

LEAST_SHARE = 0.8
"""Of the anchors beside both submaps must say the same."""

SIGMAS = 4.0
"""So many standard deviations of both places are no contradiction."""

OWN_M, OWN_SHARE, STRETCH_M = 10.0, 0.7, 150.0
"""So many of the anchors STRETCH_M before and behind a place of a drive lie where its odometry has them, but for OWN_M
beyond what is stated. Where not, a clock is wrong, or reflections are many: such a drive refutes nothing."""

STRETCHES, FITTINGS = 50, 3
"""Places of a drive, at most, beside which it is looked at; and how often the best of the anchors are chosen."""

MOST_BESIDE = 12
"""So many anchors nearest to a submap tell where it is: over a shorter way odometry bends less."""

JUMP_SIDE, JUMP_REACH_M = 5, 150.0
"""So many anchors before and behind a place of a drive show whether their errors jump there; none within JUMP_REACH_M
of a jump tells where a submap is: a receiver may be wrong for minutes, and nobody knows on which side of it.
"""

OWN_ERROR_M = 0.5
"""Anchors and odometry may differ by so much without any error that they state: a lever arm, a bend of the drive."""

LEAST_SPREAD_M = 10.0
"""The anchors beside a submap tell its heading where they lie so far, root mean square, from their middle."""


@dataclass(frozen=True)
class Fix:
    """A submap by the anchors beside it: place (2,) on the ground of the world, height, R_odom_submap (3, 3), and the
    angle there of the x axis of its odometry frame, counter-clockwise from x, radians; with a standard deviation each
    that no number of anchors makes smaller, because those of a receiver err together.
    """

    place: Array64
    height_m: float
    R_odom_submap: Array64
    turn_rad: float
    sigma_m: float
    sigma_up_m: float
    sigma_rad: float


@dataclass(frozen=True)
class _Fitted:
    """Anchors (k,) as their drive has them: `best`, those that it was fitted by; off_m (k,), how far each lies from
    where the drive puts it; `turn` of the drive, radians; the middles of the best in the odometry frame and in the
    world, as complex numbers; spread_m, their root mean square distance from it.
    """

    best: NDArray[np.bool_]
    off_m: Array64
    turn: float
    driven: complex
    told: complex
    spread_m: float


@dataclass(frozen=True)
class AnchoredDrive:
    """A drive with its anchors in the order in which it passes them.

    T_odom_submap (n, 4, 4); along_m (n,) of its submaps. Of the anchors: anchor_along_m (k,), points_odom (k, 3),
    places (k, 2) across the ground and sigmas_m (k,), heights_m (k,) and sigmas_up_m (k,).
    """

    T_odom_submap: Array64
    along_m: Array64
    anchor_along_m: Array64
    points_odom: Array64
    places: Array64
    sigmas_m: Array64
    heights_m: Array64
    sigmas_up_m: Array64

    @classmethod
    def of(cls, T_odom_submap: Array64, anchors: Sequence[Anchor]) -> AnchoredDrive:
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
            np.array([one.place_world[2] for one in anchors])[order],
            np.sqrt([one.covariance[2, 2] for one in anchors])[order],
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

    @cached_property
    def jumps_m(self) -> Array64:
        """The places (j,) along the drive where the errors of anchors jump, by more than they state, and stay so."""
        rows = self._rows(0.0, np.inf)
        sides = [
            (rows[n - JUMP_SIDE : n], rows[n : n + JUMP_SIDE]) for n in range(JUMP_SIDE, len(rows) - JUMP_SIDE + 1)
        ]
        return np.array([self.anchor_along_m[after[0]] for before, after in sides if self._is_jump(before, after)])

    def _is_jump(self, before: NDArray[np.int64], after: NDArray[np.int64]) -> bool:
        """Whether each of two runs of anchors, one behind the other, puts most of the other elsewhere."""
        if self.anchor_along_m[after[-1]] - self.anchor_along_m[before[0]] > 2.0 * BESIDE_M:
            return False
        return self._puts_elsewhere(before, after) and self._puts_elsewhere(after, before)

    def _puts_elsewhere(self, some: NDArray[np.int64], others: NDArray[np.int64]) -> bool:
        """Whether the drive, by some anchors, has most of the others elsewhere than they say."""
        fitted = self._fitted(some)
        if fitted.spread_m < 1e-6:
            return False
        driven, told = (values[others, :2] @ (1.0, 1.0j) for values in (self.points_odom, self.places))
        ways = driven - fitted.driven
        off_m = np.abs(told - fitted.told - ways * np.exp(1j * fitted.turn))
        sigma_m = self._apart_m(some, fitted) * np.hypot(1.0, np.abs(ways) / fitted.spread_m)
        return bool(np.median(off_m - SIGMAS * np.hypot(sigma_m, self.sigmas_m[others])) > OWN_ERROR_M)

    def _apart_m(self, rows: NDArray[np.int64], fitted: _Fitted) -> float:
        """The standard deviation of a place by some anchors: as stated, and as the best of them differ."""
        return float(np.hypot(np.median(self.sigmas_m[rows]), np.sqrt(np.mean(fitted.off_m[fitted.best] ** 2))))

    def _rows(self, along_m: float, reach_m: float) -> NDArray[np.int64]:
        """The anchors that count within reach of a place of the drive, in its order."""
        first, last = np.searchsorted(self.anchor_along_m, (along_m - reach_m, along_m + reach_m))
        parts = (self.anchor_along_m[first:last] - along_m) // EACH_M
        return np.asarray(first + np.flatnonzero(np.diff(parts, prepend=-np.inf)))

    def fix(self, ordinal: int) -> Fix | None:
        """Where anchors put a submap; None where too few lie beside it, too near each other to tell a heading, or not
        far from a jump of their errors.
        """
        rows = self._rows(self.along_m[ordinal], BESIDE_M)
        if len(rows) < LEAST_BESIDE or (np.abs(self.jumps_m - self.along_m[ordinal]) < JUMP_REACH_M).any():
            return None
        rows = rows[np.argsort(np.abs(self.anchor_along_m[rows] - self.along_m[ordinal]), kind="stable")[:MOST_BESIDE]]
        fitted = self._fitted(rows)
        if fitted.spread_m < LEAST_SPREAD_M:
            return None
        apart_m = self._apart_m(rows, fitted)
        turn_sigma = apart_m / fitted.spread_m
        T_odom_submap = self.T_odom_submap[ordinal]
        way = complex(T_odom_submap[:2, 3] @ (1.0, 1.0j)) - fitted.driven
        place = fitted.told + way * np.exp(1j * fitted.turn)
        rise_m, unsure_m = self._rise_m(ordinal, rows[fitted.best])
        return Fix(
            np.array([place.real, place.imag]),
            float(T_odom_submap[2, 3] + rise_m),
            T_odom_submap[:3, :3],
            fitted.turn,
            float(np.hypot(apart_m, turn_sigma * abs(way))),
            float(np.hypot(np.median(self.sigmas_up_m[rows]), unsure_m)),
            turn_sigma,
        )

    def _rise_m(self, ordinal: int, rows: NDArray[np.int64]) -> tuple[float, float]:
        """How far above its odometry some anchors put a submap, and the root mean square of what they differ by.

        The heights of odometry drift along the way: evenly, as far as the anchors lie.
        """
        along_m = self.anchor_along_m[rows] - self.along_m[ordinal]
        rises_m = self.heights_m[rows] - self.points_odom[rows, 2]
        evenly = np.stack([np.ones(len(rows)), along_m], axis=1)
        found, *_ = np.linalg.lstsq(evenly, rises_m, rcond=None)
        return float(found[0]), float(np.sqrt(np.mean((rises_m - evenly @ found) ** 2)))

    def _is_as_driven(self, rows: NDArray[np.int64]) -> bool:
        """Whether most of some anchors lie where the odometry has them, moved and turned on the ground as fits best."""
        allowed_m = OWN_M + SIGMAS * self.sigmas_m[rows]
        return bool((self._fitted(rows).off_m < allowed_m).mean() >= OWN_SHARE)

    def _fitted(self, rows: NDArray[np.int64]) -> _Fitted:
        """Some anchors where the odometry has them, moved and turned on the ground as fits the best of them best."""
        driven, told = (values[rows, :2] @ (1.0, 1.0j) for values in (self.points_odom, self.places))
        best = np.ones(len(rows), dtype=np.bool_)
        for _ in range(FITTINGS):
            centres = driven[best].mean(), told[best].mean()
            a, b = driven - centres[0], told - centres[1]
            turn = float(np.angle(np.vdot(a[best], b[best])))
            off_m = np.abs(b - a * np.exp(1j * turn))
            spread_m = float(np.sqrt(np.mean(np.abs(a[best]) ** 2)))
            found = _Fitted(best, off_m, turn, *centres, spread_m)
            best = off_m <= max(np.quantile(off_m, OWN_SHARE), np.sort(off_m)[:LEAST_BESIDE][-1])
        return found


def anchored_drives(T_odom_submap: Mapping[str, Array64], anchors: Sequence[Anchor]) -> dict[str, AnchoredDrive]:
    """The sessions that have anchors, by name. T_odom_submap (n, 4, 4): the drive of each session."""
    of_session: dict[str, list[Anchor]] = {}
    for anchor in anchors:
        of_session.setdefault(anchor.node.session, []).append(anchor)
    return {name: AnchoredDrive.of(T_odom_submap[name], its) for name, its in of_session.items()}


def _directions(T_odom_submap: Array64) -> Array64:
    """Unit vectors (n, 3) in which a drive goes on at its submaps; zero where it stands."""
    places = T_odom_submap[:, :3, 3]
    steps = np.gradient(places, axis=0) if len(places) > 1 else np.zeros_like(places)
    return np.asarray(steps / np.maximum(np.linalg.norm(steps, axis=1), 1e-9)[:, None])
