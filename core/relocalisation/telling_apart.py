"""What would tell possible poses apart: the drive after which the map expects the most unlike views of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4
from revisit.core.relocalisation.answer import TellsApart

ASKED = 4
"""Poses that are told apart, the most probable ones."""

REACH_M = 20.0
"""Drives are looked at up to this length, times the scale of the scene."""


@dataclass(frozen=True)
class Surroundings:
    """What the map has around a pose T_frame_view (4, 4) that may be true.

    positions (p, 3) of the places stored around it, in the frame; descriptors (p, d), unit vectors.
    """

    T_frame_view: Matrix4
    probability: float
    positions: NDArray[np.float64]
    descriptors: NDArray[np.float32]


def tells_apart(around: Sequence[Surroundings], scale: float) -> TellsApart | None:
    """The shortest of the drives that tell the poses about best apart; None where none does.

    A drive counts where the map has places at its end for at least two of the poses: then a robot may be able to go
    there, and their descriptors tell how unlike the views are.
    """
    drives = [(turn, length_m * scale) for length_m in _LENGTHS_M for turn in _TURNS]
    ends = np.array([[d * np.cos(turn), d * np.sin(turn), 0.0] for turn, d in drives])
    expected = [_expected(one, ends, _NEAR_M * scale) for one in around]
    best: TellsApart | None = None
    for row, (turn, length_m) in enumerate(drives):
        difference = _difference([one[row] for one in expected], [one.probability for one in around])
        if difference >= _LEAST and (best is None or difference > best.difference + _BETTER):
            best = TellsApart(float(turn), float(length_m), difference)
    return best


def _expected(one: Surroundings, ends: NDArray[np.float64], near_m: float) -> list[NDArray[np.float32] | None]:
    """The descriptor that the map has at each end (e, 3) of a drive from a pose; None where it has none."""
    if not len(one.positions):
        return [None] * len(ends)
    there = se3.apply(one.T_frame_view, ends)
    apart_m = np.linalg.norm(there[:, None, :2] - one.positions[None, :, :2], axis=2)
    nearest = apart_m.argmin(axis=1)
    return [one.descriptors[row] if apart_m[end, row] <= near_m else None for end, row in enumerate(nearest)]


def _difference(expected: Sequence[NDArray[np.float32] | None], probabilities: Sequence[float]) -> float:
    """How unlike the views are, 0..1: the mean over pairs of poses, by their probability."""
    total = weight = 0.0
    for row, one in enumerate(expected):
        for other_row in range(row + 1, len(expected)):
            other = expected[other_row]
            if one is None or other is None:
                continue
            share = probabilities[row] * probabilities[other_row]
            total += share * float(np.clip(1.0 - one @ other, 0.0, 1.0))
            weight += share
    return total / weight if weight > 0.0 else 0.0


_LENGTHS_M = (4.0, 7.0, 10.0, 14.0, 20.0)
_TURNS = np.radians([0.0, 45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0])
_NEAR_M = 3.5
_LEAST, _BETTER = 0.15, 0.05
