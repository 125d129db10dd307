"""A map on earth: its poses by the drives, the loops in it and the anchors that agree, and its place in the world.

Steps and loops in the map are known to be right here: no anchor sets a loop aside. Anchors are judged by graduated
non-convexity, then by gates, as loops are. Nothing moves before the place and the heading of a map are well
determined: an anchor that acts while the heading is unknown shears the map.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3, se3_rows
from revisit.core.pose_graph.absolute_edges import AbsoluteEdges, GroundedEdges
from revisit.core.pose_graph.alignment import absolute_edges, aligned, heading_sigma_rad, level
from revisit.core.pose_graph.anchors import (
    LEAST_ANCHORS,
    LEAST_SHARE,
    MOST_HEADING_SIGMA_RAD,
    Anchor,
    AnchorReason,
    AnchorState,
    Georeference,
    JudgedAnchor,
)
from revisit.core.pose_graph.held_component import HeldComponent
from revisit.core.pose_graph.least_squares import graduated, minimise, settled
from revisit.core.pose_graph.odometry_weights import by_weighed_odometry
from revisit.core.pose_graph.receivers import Receiver, as_sure_as_they_are, elsewhere, not_as_stated, receivers, spread

Array64 = NDArray[np.float64]

GATE = 16.27
"""Squared Mahalanobis distance of an anchor from the poses: chi-square with 3 degrees of freedom, 99.9 %."""

MAX_GATINGS = 5


@dataclass(frozen=True)
class Solution:
    """A component as its anchors hold it: poses and covariances by session as of `OptimisedGraph`; residuals of its
    loops by their place in the graph; by how much chi2 and its degrees of freedom are more than without anchors.
    """

    T_map_submap: dict[str, Array64]
    covariances: dict[str, Array64]
    residuals: dict[int, float]
    chi2_more: float
    degrees_more: int
    georeference: Georeference


@dataclass(frozen=True)
class Grounded:
    """The verdicts on the anchors of a component, and its solution; None where nothing is aligned."""

    anchors: tuple[JudgedAnchor, ...]
    solution: Solution | None = None


@dataclass(frozen=True)
class Grounding:
    """One component, as it was solved without them, with its anchors, as sure as their receivers are."""

    component: HeldComponent
    anchors: tuple[Anchor, ...]
    absolute: AbsoluteEdges
    receivers: Sequence[Receiver]

    @classmethod
    def of(cls, component: HeldComponent, anchors: Sequence[Anchor]) -> Grounding:
        """A component with these anchors."""
        stated = absolute_edges(anchors, component.rows)
        its = receivers(anchors, stated, component.before)
        if all(one.raised == 1.0 for one in its):
            return cls(component, tuple(anchors), stated, its)
        sure = as_sure_as_they_are(anchors, its)
        return cls(component, sure, absolute_edges(sure, component.rows), its)

    def solved(self) -> Grounded:
        """The component by its anchors, or the reason why they do not hold it."""
        before = self.component.before
        if (reason := _too_weak(self.anchors, self.absolute, before)) is not None:
            return _refused(self.anchors, reason)
        terms = GroundedEdges(self.component.edges, level(0, before[0]).joined(self.absolute))
        poses, kept = self._by_most(terms, *_solved(terms, aligned(self.absolute, before) @ before))
        agreeing = list(itertools.compress(self.anchors, kept))
        if _weight(agreeing) < LEAST_SHARE * _weight(self.anchors):
            return _refused(self.anchors, AnchorReason.MOSTLY_DISAGREE)
        if (reason := _too_weak(agreeing, self.absolute.chosen(kept), poses)) is not None:
            return _refused(self.anchors, reason)
        poses = by_weighed_odometry(self.component.trajectories, _heard(terms, kept), None, poses)
        return Grounded(self._judged(poses, kept), self._solution(terms, poses, kept))

    def _by_most(
        self, terms: GroundedEdges, poses: Array64, kept: NDArray[np.bool_]
    ) -> tuple[Array64, NDArray[np.bool_]]:
        """The same; or as the anchors of those sessions say that lie elsewhere as a whole, where they are more.

        Few anchors that state to be sure outweigh many: a wrong base station would take the map along.
        """
        away = self._elsewhere(poses)
        if 2 * self._submaps(away) <= self._submaps(np.ones_like(away)):
            return poses, kept
        some = self.absolute.chosen(away)
        if _too_weak(list(itertools.compress(self.anchors, away)), some, self.component.before) is not None:
            return poses, kept
        alone = _heard(terms, away)
        start, _ = _solved(alone, aligned(some, self.component.before) @ self.component.before)
        others = _gated(terms, start)
        return others if self._submaps(self._elsewhere(others[0])) < self._submaps(away) else (poses, kept)

    def _elsewhere(self, poses: Array64) -> NDArray[np.bool_]:
        return elsewhere(self.receivers, self.anchors, self.absolute, poses)

    def _submaps(self, which: NDArray[np.bool_]) -> int:
        """How many submaps have these anchors: receivers differ in how often they tell one."""
        return len(np.unique(self.absolute.rows[which]))

    def _judged(self, poses: Array64, kept: NDArray[np.bool_]) -> tuple[JudgedAnchor, ...]:
        misfits, squared = -self.absolute.errors(poses)[:, :3], self.absolute.squared_errors(poses)
        return tuple(
            JudgedAnchor(*_VERDICTS[bool(one)], misfit, float(distance))
            for one, misfit, distance in zip(kept, misfits, squared, strict=True)
        )

    def _solution(self, terms: GroundedEdges, poses: Array64, kept: NDArray[np.bool_]) -> Solution:
        """From poses (n, 4, 4) in the world to those of a map whose first pose stays where it was."""
        component, agreeing = self.component, self.absolute.chosen(kept)
        T_world_map = poses[0] @ se3.inverse(component.before[0])
        of_first, covariances = _covariances(_heard(terms, kept), poses)
        turn, errors = se3.adjoint(component.before[0]), -self.absolute.errors(poses)[:, :3]
        covariance, to_map = turn @ of_first @ turn.T, T_world_map[:3, :3].T
        covariance[:3, :3] += to_map @ spread(self.receivers, kept, errors) @ to_map.T
        georeference = Georeference(
            session=component.trajectories[0].session,
            T_world_map=T_world_map,
            covariance=covariance,
            heading_sigma_rad=heading_sigma_rad(agreeing, poses),
            anchors=int(kept.sum()),
            of_anchors=len(kept),
            residual_m=float(np.sqrt((errors[kept, :2] ** 2).sum(axis=1).mean())),
            sessions=not_as_stated(self.receivers, self.anchors, kept, errors),
        )
        return Solution(
            component.by_session(se3.inverse(T_world_map) @ poses),
            component.by_session(covariances),
            component.squared_distances(poses),
            float(_heard(terms, kept).squared_errors(poses).sum() - component.squared_errors(component.before)),
            3 * len(agreeing) + sum(one.heading is not None for one in itertools.compress(self.anchors, kept)) - 4,
            georeference,
        )


def _weight(anchors: Sequence[Anchor]) -> int:
    """How much anchors say together: a heading as much as three more places."""
    return sum(1 if one.heading is None else LEAST_ANCHORS for one in anchors)


def _too_weak(anchors: Sequence[Anchor], absolute: AbsoluteEdges, poses: Array64) -> AnchorReason | None:
    """The reason why anchors that agree do not tell place and heading of a map well enough; None where they do."""
    if _weight(anchors) < LEAST_ANCHORS:
        return AnchorReason.TOO_FEW
    return AnchorReason.NOT_SPREAD if heading_sigma_rad(absolute, poses) > MOST_HEADING_SIGMA_RAD else None


def _refused(anchors: Sequence[Anchor], reason: AnchorReason) -> Grounded:
    """Nothing is aligned, for a reason."""
    return Grounded(tuple(JudgedAnchor(AnchorState.NOT_ALIGNED, reason, np.full(3, np.nan), np.nan) for _ in anchors))


def _solved(terms: GroundedEdges, start: Array64) -> tuple[Array64, NDArray[np.bool_]]:
    """The poses in the world, and which anchors (k,) they rest on: those within the gate around them."""
    known = len(terms.edges) + 1
    return _gated(terms, graduated(terms, known, None, start))


def _gated(terms: GroundedEdges, poses: Array64) -> tuple[Array64, NDArray[np.bool_]]:
    """The same from poses that lie near."""
    known = len(terms.edges) + 1
    kept = terms.squared_errors(poses)[known:] < GATE
    for _ in range(MAX_GATINGS):
        poses = minimise(_heard(terms, kept), None, poses)
        before, kept = kept, terms.squared_errors(poses)[known:] < GATE
        if (kept == before).all():
            break
    heard = _heard(terms, kept)
    return settled(heard, None, minimise(heard, None, poses)), kept


def _heard(terms: GroundedEdges, kept: NDArray[np.bool_]) -> GroundedEdges:
    """The terms with those anchors alone that are kept."""
    known = len(terms.edges) + 1
    return terms.chosen(np.concatenate([np.ones(known, dtype=np.bool_), kept]))


_VERDICTS: dict[bool, tuple[AnchorState, AnchorReason | None]] = {
    True: (AnchorState.IN_MAP, None),
    False: (AnchorState.SET_ASIDE, AnchorReason.DISAGREES),
}


def _covariances(heard: GroundedEdges, poses: Array64) -> tuple[Array64, Array64]:
    """The covariance (6, 6) of the first pose in the world, and those (n, 6, 6) of all as seen from the first; NaN
    where they are too large to be computed.
    """
    try:
        known = heard.linearised(poses, heard.errors(poses), np.ones(len(heard))).factorised(None)
    except RuntimeError:
        return np.full((6, 6), np.nan), np.full((len(poses), 6, 6), np.nan)
    of_first = np.zeros((6 * len(poses), 6))
    of_first[:6] = np.eye(6)
    beside, own = known.solve(of_first).reshape(-1, 6, 6), known.covariances()
    back = se3_rows.adjoint(se3_rows.inverse(poses) @ poses[0])
    shared = beside @ back.transpose(0, 2, 1)
    seen = own - shared - shared.transpose(0, 2, 1) + back @ own[0] @ back.transpose(0, 2, 1)
    return own[0], 0.5 * (seen + seen.transpose(0, 2, 1))
