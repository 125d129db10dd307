"""Candidate policy: which earlier submaps are verified as loop closures of a new one, and how many (paper IV-B)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.config import LoopConfig
from revisit.core.geometry.path import travelled_m

Flags = NDArray[np.bool_]
Positions = NDArray[np.float64]

ASIDE = 3.0
"""A lane that is driven back lies no farther aside, times the distance by which a drive must leave a place."""


@dataclass(frozen=True)
class CandidatePolicy:
    """The candidates of a submap of `session`: of all but those with the ids `too_near`, the `count` most similar."""

    session: int
    too_near: frozenset[int]
    count: int


def candidate_policy(
    session: int, ids: NDArray[np.int64], positions: Positions, row: int, config: LoopConfig
) -> CandidatePolicy:
    """The policy for the submap in `row` of a drive: ids (n,) and positions (n, 3) of its submaps, in their order."""
    near = ids[~are_revisits(positions, row, config)]
    return CandidatePolicy(session, frozenset(near.tolist()), config.candidates)


def are_revisits(positions: Positions, row: int, config: LoopConfig, aside: float = ASIDE) -> Flags:
    """Which submaps of a drive (n,) may be loops with the one in `row`; positions (n, 3) are in metres, in odometry.

    A place just left is no loop, one that was left and entered again is: both submaps lie within `leave_distance` of
    each other, and between them the drive was farther than that from both. One that was passed again aside is, too:
    both lie within `aside` times that distance, and in between the drive was farther from both, by more than the
    distance (docs/decisions/0353). Odometry drifts, so the distance grows by `drift` times the way between them. Once
    it has doubled, odometry cannot tell: then any submap may be a loop. Two submaps with a scan in common are none,
    where `leave_distance` is half of tau or more.
    """
    way_m = np.abs(travelled_m(positions) - travelled_m(positions)[row])
    radius_m = config.leave_distance + config.drift * way_m
    apart_m = np.linalg.norm(positions - positions[row], axis=1)
    left_m = radius_m + np.where(apart_m <= radius_m, 0.0, apart_m)
    reach_m = radius_m + (aside - 1.0) * config.leave_distance
    entered = np.flatnonzero((apart_m <= reach_m) & (_farthest_between(apart_m, row) > left_m))
    left = [other for other in entered.tolist() if _farthest_from(positions, other, row) > left_m[other]]
    revisits = way_m * config.drift >= config.leave_distance
    revisits[left] = True
    revisits[row] = False
    return np.asarray(revisits)


def way_read_m(config: LoopConfig) -> float:
    """The way from a submap after which every submap may be a loop with it, metres: of others no path is needed."""
    return config.leave_distance / config.drift


def _farthest_between(apart_m: NDArray[np.float64], row: int) -> NDArray[np.float64]:
    """The largest of the distances (n,) from each one on to that in `row`."""
    before = np.maximum.accumulate(apart_m[row::-1])[::-1]
    return np.concatenate([before, np.maximum.accumulate(apart_m[row:])[1:]])


def _farthest_from(positions: Positions, one: int, other: int) -> float:
    """The farthest from the submap `one` that the drive was between it and `other`, metres."""
    between = positions[min(one, other) : max(one, other) + 1]
    return float(np.linalg.norm(between - positions[one], axis=1).max())
