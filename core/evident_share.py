"""How many of the pairs of submaps that one pose of two drives explains have passed every check by themselves.

Where a place repeats, some of many pairs pass by chance at a wrong pose, and the others that the same pose explains do
not: another pose fits them as well, or their score is too low. At the right pose of a place that is like no other,
nearly all pass (docs/decisions/0280).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.drive_loops import DrivePair, frames_between, ways_m

LEAST_EVIDENT = 0.36
"""A smaller share is what chance gives where places look alike."""

REACH_M = 80.0
"""Pairs of which the queries lie farther apart along their drive say nothing of each other."""

_TOLERANCE_M = 1.0
_DRIFT = 0.02
_TURN = np.radians(8.0)


@dataclass(frozen=True)
class TestedPair(DrivePair):
    """A pair of submaps of the same two drives that was tested. evident: whether it passed every check by itself."""

    __test__ = False  # no test, whatever pytest thinks of its name

    evident: bool


@dataclass(frozen=True)
class EvidentShare:
    """Of the pairs that the first pose of one explains, itself among them: how many are evident, how many there are."""

    evident: int
    pairs: int

    @property
    def is_enough(self) -> bool:
        """Whether more pass than chance would let."""
        return self.evident >= LEAST_EVIDENT * self.pairs


def evident_shares(pairs: Sequence[TestedPair], asked: Sequence[int], stride_m: float) -> list[EvidentShare]:
    """The share at the first pose of each of the pairs `asked` for, by their rows.

    `stride_m`: how far apart neighbouring submaps of the query's drive were begun.
    """
    if not asked:
        return []
    by_pair = frames_between(pairs)
    frames, owners = np.concatenate(by_pair), np.repeat(np.arange(len(pairs)), [len(said) for said in by_pair])
    way_m, evident = ways_m([pair.query for pair in pairs], stride_m), np.array([pair.evident for pair in pairs])
    position_m = np.array([pair.query.T_odom_submap[:3, 3] for pair in pairs])[owners]
    found = []
    for row in asked:
        explained = np.zeros(len(pairs), dtype=bool)
        explained[owners[_agree(frames, by_pair[row][0], position_m, way_m[row, owners])]] = True
        explained &= way_m[row] <= REACH_M
        found.append(EvidentShare(int((explained & evident).sum()), int(explained.sum())))
    return found


def _agree(
    frames: NDArray[np.float64], frame: NDArray[np.float64], position_m: NDArray[np.float64], way_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Which of `frames` (h, 4, 4) put their queries, at `position_m` (h, 3), where `frame` does, `way_m` (h,) away."""
    apart = np.einsum("hab,hb->ha", frames[:, :3, :3] - frame[:3, :3], position_m) + frames[:, :3, 3] - frame[:3, 3]
    traces = np.einsum("hab,ab->h", frames[:, :3, :3], frame[:3, :3])
    near = np.linalg.norm(apart, axis=1) < _TOLERANCE_M + _DRIFT * way_m
    return np.asarray(near & (traces > 1.0 + 2.0 * np.cos(_TURN)))
