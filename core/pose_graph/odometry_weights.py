"""The weight of odometry beside loops, where the loops show that it is better than it states.

Loops beside a way are each right to some hundredths of a degree. Where odometry counts for little they outweigh it, and
their errors, summed up from one to the next, bend the way. Yet loops also show how far steps err: by their squared
errors over their redundancy, the share of a step that the loops determine (Foerstner 1979; the restricted likelihood of
the graph is greatest there). So the standard deviations of steps are reduced to that; they are never raised, and never
less than those of the best odometry there is. Odometry that drifts steadily is not told by single steps: a stretch that
is off as a whole counts, too, by as much as it is off more than loops are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3_rows
from revisit.core.pose_graph.graph import OdometryModel, Trajectory
from revisit.core.pose_graph.least_squares import ROUGHLY, T, minimise, settled
from revisit.core.pose_graph.normal_equations import Rows

Array64 = NDArray[np.float64]

BEST = OdometryModel.stated("0.002 m/m 0.005 deg/m")
"""No odometry is taken as better."""

STEADY = np.repeat([0.004, np.radians(0.006)], 3)
"""Metres and radians a metre by which loops may err alike along a whole way: of KITTI 00 up to 0.0045, and 0.0044
degrees.
"""

STEADY_WEIGHT = 2.0
"""Times the error of a stretch beyond STEADY is the standard deviation of odometry: loops correct most of it then."""

LEAST_STEPS, LEAST_STRETCH = 8, 32
"""Steps of a session, and of a part of it, that are summed: of fewer the sum is that of the errors of single loops."""

SPENT = 6.0
"""The redundancy of one loop: steps with no more are as sure as they state."""

WORSE = 6.0
"""By so much, at least, are the squared errors of a session beyond their redundancy where it is worse than others that
state its drift; not by chance (chi-square).
"""

MOST_GROWTH = 2.0
"""Of variances in a round: steps that became so sure that loops say nothing of them come back slowly."""

MAX_ROUNDS, SETTLED = 8, 0.1
"""Of the estimate, which ends where no factor changes by more than that share."""


def by_weighed_odometry(tracks: Sequence[Trajectory], terms: T, anchor: int | None, poses: Array64) -> Array64:
    """The most likely poses (n, 4, 4) with steps as sure as the graph shows them, from those with steps as they state.

    The first of the `terms` are the steps of the `tracks`, in their order; the pose in row `anchor`, if any, is held
    fast. The same poses where no odometry is better than it states.
    """
    factors, near = step_factors(tracks, terms, anchor, poses)
    if (factors == 1.0).all():
        return poses
    weighed = terms.surer(factors)
    return settled(weighed, anchor, minimise(weighed, anchor, near, ROUGHLY))


def step_factors(tracks: Sequence[Trajectory], terms: T, anchor: int | None, poses: Array64) -> tuple[Array64, Array64]:
    """The factors (s, 6), at most 1, for the standard deviations of the steps: one for the lengths and one for the
    turns of all sessions that state the same drift, larger in sessions that are worse; 1 for steps that state none, and
    mended ones. And poses (n, 4, 4)
    near the most likely ones by these.

    As `by_weighed_odometry`.
    """
    steps, errors = _Steps.of(tracks), terms.errors(poses)
    factors = np.ones_like(steps.variances)
    classes = [(rows, steps.least(model, rows, errors)) for model, rows in steps.classes.items()]
    classes = [(rows, least) for rows, least in classes if (least < 1.0).any()]
    try:
        for _ in range(MAX_ROUNDS if classes and len(terms) > len(factors) else 0):
            before = factors.copy()
            squared, redundancy, poses = steps.shares(terms, factors, anchor, poses)
            for sessions, least in classes:
                if anchor is None:  # the world shows errors that loops share
                    least = np.maximum(least, steps.turned(sessions, terms.errors(poses)))
                found = [(_pooled(squared[rows]), _pooled(redundancy[rows])) for rows in sessions]
                for rows, squares in zip(sessions, _squares(found), strict=True):
                    factors[rows] = np.clip(factors[rows] * np.sqrt(squares), least, 1.0)
            if np.abs(np.log(factors / before)).max() < SETTLED:
                break
    except RuntimeError:  # too large to be computed: long chains that nothing ties
        return np.ones_like(factors), poses
    return factors, poses


@dataclass(frozen=True)
class _Steps:
    """The steps of some trajectories: variances (s, 6) as stated, lengths_m (s,), and by the drift that is stated the
    rows of each session whose odometry states it.
    """

    variances: Array64
    lengths_m: Array64
    classes: dict[OdometryModel, list[Rows]]

    @classmethod
    def of(cls, tracks: Sequence[Trajectory]) -> _Steps:
        classes: dict[OdometryModel, list[Rows]] = {}
        ends = np.cumsum([0, *(len(one) - 1 for one in tracks)])
        for one, begin in zip(tracks, ends[:-1], strict=True):
            is_known = np.ones(len(one) - 1, dtype=np.bool_)
            for first, last in one.mended:
                is_known[first:last] = False
            if one.odometry is not None and is_known.any():
                classes.setdefault(one.odometry, []).append(begin + np.flatnonzero(is_known))
        places = [np.diff(one.T_odom_submap[:, :3, 3], axis=0) for one in tracks]
        return cls(
            np.concatenate([np.diagonal(one.step_covariances, axis1=1, axis2=2) for one in tracks]),
            np.linalg.norm(np.concatenate(places), axis=1),
            classes,
        )

    def least(self, model: OdometryModel, stretches: Sequence[Rows], errors: Array64) -> Array64:
        """The least factors (6,) of sessions that state this drift: those of BEST; and where whole stretches are off,
        by the `errors` (e, 6) of the steps as they state, so much for lengths and turns.
        """
        best = [BEST.translation / model.translation, BEST.rotation_rad_per_m / model.rotation_rad_per_m]
        return np.asarray(np.clip(np.maximum(np.repeat(best, 3), self._steady(stretches, errors)), 0.0, 1.0))

    def _steady(self, stretches: Sequence[Rows], errors: Array64) -> float:
        """The factor by sessions, their halves, quarters ... that are off as a whole: the largest of these."""
        sums: dict[int, Array64] = {}
        for rows in stretches:
            halvings, length = 0, len(rows)
            while length >= (LEAST_STRETCH if halvings else LEAST_STEPS):
                some = rows[: len(rows) // length * length].reshape(-1, length)
                allowed = STEADY * self.lengths_m[some].sum(axis=1)[:, None]
                off = np.maximum(np.abs(errors[some].sum(axis=1)) - allowed, 0.0)
                both = np.stack([(off**2).sum(axis=0), self.variances[some].sum(axis=(0, 1))])
                sums[halvings] = sums.get(halvings, 0.0) + both
                halvings, length = halvings + 1, length // 2
        return STEADY_WEIGHT * max((float(np.sqrt(off / stated).max()) for off, stated in sums.values()), default=0.0)

    def turned(self, sessions: Sequence[Rows], errors: Array64) -> Array64:
        """The least factors (6,) by the `errors` (e, 6) of sessions that are turned as a whole; 0 for lengths."""
        whole = [rows for rows in sessions if len(rows) >= LEAST_STEPS]
        off = np.sum([errors[rows, 3:].sum(axis=0) ** 2 for rows in whole], axis=0)
        stated = np.sum([self.variances[rows, 3:].sum(axis=0) for rows in whole], axis=0)
        return np.repeat([0.0, min(float(np.sqrt(off / stated).max()), 1.0) if whole else 0.0], 3)

    def shares(
        self, terms: T, factors: Array64, anchor: int | None, poses: Array64
    ) -> tuple[Array64, Array64, Array64]:
        """The squared errors (s, 6) of the steps in variances, with their standard deviations times `factors` (s, 6),
        their redundancy (s, 6), and the poses a step nearer to the most likely ones with these.
        """
        weighed, count, variances = terms.surer(factors), len(factors), self.variances * factors**2
        equations = weighed.linearised(poses, weighed.errors(poses), np.ones(len(weighed)))
        known = equations.factorised(anchor)
        step = known.solve(-equations.gradient)
        if anchor is not None:
            step[anchor] = 0.0
        poses = poses @ se3_rows.exp(step)
        squared = weighed.errors(poses)[:count] ** 2 / variances
        across, own = known.covariances_with_edges(count)
        first, second = equations.edges.first[:count], equations.edges.second[:count]
        turn = se3_rows.adjoint(se3_rows.inverse(poses[second]) @ poses[first])
        back = turn @ across
        moving = own[second] - back - back.transpose(0, 2, 1) + turn @ own[first] @ turn.transpose(0, 2, 1)
        return squared, 1.0 - np.diagonal(moving, axis1=1, axis2=2) / variances, poses


def _squares(found: Sequence[tuple[Array64, Array64]]) -> list[Array64]:
    """The factors (6,) for the variances of each of some sessions that state the same drift, by their squared errors
    (6,) and redundancy (6,): the same for all, and more for those that are worse by themselves.
    """
    of_all = np.sum(found, axis=0)
    shared = _by_redundancy(of_all[0], of_all[1] - SPENT)
    worse = (np.where(own > said + WORSE, _by_redundancy(own, said), 0.0) for own, said in found)
    return [np.maximum(shared, own) for own in worse]


def _by_redundancy(squared: Array64, redundancy: Array64) -> Array64:
    """Squared errors (6,) over their redundancy (6,), MOST_GROWTH at most."""
    known = np.minimum(squared / np.maximum(redundancy, 1e-9), MOST_GROWTH)
    return np.where(redundancy > 0.0, known, MOST_GROWTH)


def _pooled(values: Array64) -> Array64:
    """The sums (6,) of values (s, 6) of lengths, thrice, and of turns, thrice."""
    return np.repeat(values.reshape(-1, 2, 3).sum(axis=(0, 2)), 3)
