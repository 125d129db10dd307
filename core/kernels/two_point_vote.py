"""The two-point vote: try the planar pose of every two correspondences and keep the one most others agree with."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Array64 = NDArray[np.float64]

SHORTEST_BASE = 4.0
"""Two correspondences define a yaw only where their points lie at least so many tolerances apart."""


@numba.njit(cache=True, error_model="numpy")
def angle_between(one: float, other: float) -> float:
    """The absolute difference of two angles in radians, in [0, pi]."""
    return abs((one - other + np.pi) % (2.0 * np.pi) - np.pi)


@numba.njit(cache=True, error_model="numpy")
def votes(
    source: Array64, target: Array64, yaws: Array64, pose: Array64, tolerance: float, yaw_tolerance: float
) -> float:
    """How many correspondences agree with `pose` (yaw, x, y): in position, and in the yaw that each implies."""
    c, s = np.cos(pose[0]), np.sin(pose[0])
    agree = 0.0
    for k in range(len(source)):
        dx = c * source[k, 0] - s * source[k, 1] + pose[1] - target[k, 0]
        dy = s * source[k, 0] + c * source[k, 1] + pose[2] - target[k, 1]
        if dx * dx + dy * dy <= tolerance * tolerance and angle_between(yaws[k], pose[0]) < yaw_tolerance:
            agree += 1.0
    return agree


@numba.njit(cache=True, error_model="numpy")
def best_two_point_pose(
    source: Array64, target: Array64, yaws: Array64, tolerance: float, yaw_tolerance: float
) -> Array64:
    """The pose (yaw, x, y) of two correspondences with the most votes, and their number; all zero where there is none.

    source (n, 2) and target (n, 2) are the corresponding points in metres, yaws (n,) what each implies in radians. A
    pair is tried where its two distances differ by at most `tolerance`, and both yaws by at most `yaw_tolerance` from
    that of the pair. Of poses with equally many votes the first counts.
    """
    best = np.zeros(4)
    pose = np.zeros(3)
    for i in range(len(source)):
        for j in range(i + 1, len(source)):
            sx, sy = source[j, 0] - source[i, 0], source[j, 1] - source[i, 1]
            tx, ty = target[j, 0] - target[i, 0], target[j, 1] - target[i, 1]
            length = np.sqrt(sx * sx + sy * sy)
            if length < SHORTEST_BASE * tolerance or abs(length - np.sqrt(tx * tx + ty * ty)) > tolerance:
                continue
            yaw = np.arctan2(sx * ty - sy * tx, sx * tx + sy * ty)
            if angle_between(yaws[i], yaw) > yaw_tolerance or angle_between(yaws[j], yaw) > yaw_tolerance:
                continue
            c, s = np.cos(yaw), np.sin(yaw)
            mx, my = 0.5 * (source[i, 0] + source[j, 0]), 0.5 * (source[i, 1] + source[j, 1])
            pose[0] = yaw
            pose[1] = 0.5 * (target[i, 0] + target[j, 0]) - (c * mx - s * my)
            pose[2] = 0.5 * (target[i, 1] + target[j, 1]) - (s * mx + c * my)
            agree = votes(source, target, yaws, pose, tolerance, yaw_tolerance)
            if agree > best[3]:
                best[:3] = pose
                best[3] = agree
    return best
