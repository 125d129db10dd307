"""Anchors of one session come of one receiver, or of one pair of eyes: their errors are alike.

A receiver may be less sure than it states. This is seen in the steps between its anchors, which the drive knows better.
And all of its anchors may be off together: a base station whose place is wrong, heights above another surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.pose_graph.absolute_edges import AbsoluteEdges
from revisit.core.pose_graph.alignment import LEAST_SIGMA_M, aligned
from revisit.core.pose_graph.anchors import LEAST_ANCHORS, Anchor, AnchoredSession

Array64 = NDArray[np.float64]
Which = NDArray[np.bool_]

TOO_SURE = 2.0
"""From so many times its stated standard deviation on, a receiver's is raised."""

MOST_RAISED_M = 5.0
"""No standard deviation is raised beyond: anchors whose steps contradict the drive by more are wrong."""

LEAST_STEPS, STEP_M = 8, 30.0
"""So many steps between anchors, no longer than this, tell how sure a receiver is: a car has a fix in 20 m."""

STEP_DRIFT = 0.02
"""Of its length a step of the drive may err by, one standard deviation."""

CHI_SQUARE_3_MEDIAN = 2.366

ELSEWHERE = 9.0
"""Squared Mahalanobis distance, by the covariance of one anchor, from which on the anchors of a session lie elsewhere
as a whole: three standard deviations. The errors of a good receiver last for minutes, within one."""

BESIDE = 1.0
"""From this squared distance on anchors of a session lie beside the map as a whole, which is told: the
errors of good ones lie around none."""

MOST_TOLD = 50
"""Sessions that are told, the furthest off first."""

ELSEWHERE_M = 0.2
"""So far a map that bends a little may have whole sessions beside their anchors, one standard deviation."""


@dataclass(frozen=True)
class Receiver:
    """The anchors of a session: their rows, and by what factor their standard deviations were raised, 1 where not."""

    session: str
    rows: NDArray[np.int64]
    raised: float = 1.0


def receivers(anchors: Sequence[Anchor], absolute: AbsoluteEdges, poses: Array64) -> list[Receiver]:
    """The receivers of anchors, `absolute` as terms of least squares, by how they fit to poses (n, 4, 4)."""
    misfits = _misfits(absolute, poses)
    rows: dict[str, list[int]] = {}
    for row in np.argsort(absolute.rows, kind="stable").tolist():
        rows.setdefault(anchors[row].node.session, []).append(row)
    return [Receiver(one, np.array(its), _raised(anchors, its, misfits, poses, absolute)) for one, its in rows.items()]


def as_sure_as_they_are(anchors: Sequence[Anchor], its: Sequence[Receiver]) -> tuple[Anchor, ...]:
    """The anchors with the standard deviations of their receivers, at least 1 cm where these were raised."""
    found = list(anchors)
    for receiver in its:
        for row in receiver.rows.tolist() if receiver.raised > 1.0 else ():
            found[row] = replace(found[row], covariance=receiver.raised**2 * _floored(found[row]))
    return tuple(found)


def elsewhere(its: Sequence[Receiver], anchors: Sequence[Anchor], absolute: AbsoluteEdges, poses: Array64) -> Which:
    """The anchors (k,) of receivers that lie elsewhere as a whole than poses (n, 4, 4) have them."""
    found, misfits = np.zeros(len(anchors), dtype=np.bool_), -absolute.errors(poses)[:, :3]
    for receiver in its:
        found[receiver.rows] = _offset(receiver, anchors, misfits)[1] > ELSEWHERE
    return found


def _offset(receiver: Receiver, anchors: Sequence[Anchor], misfits: Array64) -> tuple[Array64, float]:
    """The median (3,) of the misfits of a receiver's anchors, and its squared distance by the covariance of one."""
    offset = np.median(misfits[receiver.rows], axis=0)
    of_one = np.median([anchors[row].covariance for row in receiver.rows], axis=0) + ELSEWHERE_M**2 * np.eye(3)
    return offset, float(offset @ np.linalg.solve(of_one, offset))


def not_as_stated(
    its: Sequence[Receiver], anchors: Sequence[Anchor], kept: Which, misfits: Array64
) -> tuple[AnchoredSession, ...]:
    """The receivers that are less sure than they state, or whose anchors lie beside the map as a whole; kept (k,), the
    anchors that hold it; misfits (k, 3), their places less the map's.
    """
    found = list[AnchoredSession]()
    for one in its:
        offset, squared = _offset(one, anchors, misfits)
        beside = squared > (BESIDE if len(one.rows) >= LEAST_ANCHORS else ELSEWHERE)
        if beside or one.raised > 1.0:
            counts = int(kept[one.rows].sum()), len(one.rows)
            found.append(AnchoredSession(one.session, *counts, offset, squared, one.raised, squared > ELSEWHERE))
    return tuple(sorted(found, key=lambda one: (-one.squared_distance, one.session))[:MOST_TOLD])


def spread(its: Sequence[Receiver], kept: Which, misfits: Array64) -> Array64:
    """The covariance (3, 3) of the place of a map by how far its receivers lie apart, m^2; zero of a single one."""
    means = [misfits[rows].mean(axis=0) for one in its if len(rows := one.rows[kept[one.rows]])]
    return np.cov(np.transpose(means)) / len(means) if len(means) > 1 else np.zeros((3, 3))


def _misfits(absolute: AbsoluteEdges, poses: Array64) -> Array64:
    """Where poses (n, 4, 4) have the points (k, 3) once they are aligned with the anchors, less their places."""
    return se3.apply(aligned(absolute, poses), absolute.points_at(poses)) - absolute.places


def _raised(
    anchors: Sequence[Anchor], rows: list[int], misfits: Array64, poses: Array64, absolute: AbsoluteEdges
) -> float:
    """By what factor the standard deviations of the anchors in `rows`, in the order of the drive, must be raised.

    The median tells: a reflected fix makes two steps wrong. Anchors with a heading tell no step.
    """
    its = [row for row in rows if anchors[row].heading is None]
    covariances = np.reshape([_floored(anchors[row]) for row in its], (-1, 3, 3))
    steps_m = np.linalg.norm(np.diff(absolute.points_at(poses)[its], axis=0), axis=1)
    short = steps_m < STEP_M
    if short.sum() < LEAST_STEPS:
        return 1.0
    errors, stated = np.diff(misfits[its], axis=0)[short], (covariances[1:] + covariances[:-1])[short]
    drift = ((STEP_DRIFT * steps_m[short]) ** 2)[:, None, None] * np.eye(3)
    if _times_stated(errors, stated + drift) < TOO_SURE:
        return 1.0
    factor = _times_stated(errors, stated)
    sigma_m = float(np.sqrt(np.median(covariances[:, :2, :2].trace(axis1=1, axis2=2)) / 2.0))
    return factor if factor * sigma_m <= MOST_RAISED_M else 1.0


def _times_stated(errors: Array64, covariances: Array64) -> float:
    """By how much errors (k, 3) are larger than their covariances (k, 3, 3) state."""
    squared = np.einsum("ki,ki->k", errors, np.linalg.solve(covariances, errors[:, :, None])[:, :, 0])
    return float(np.sqrt(np.median(squared) / CHI_SQUARE_3_MEDIAN))


def _floored(anchor: Anchor) -> Array64:
    return anchor.covariance + LEAST_SIGMA_M**2 * np.eye(3)
