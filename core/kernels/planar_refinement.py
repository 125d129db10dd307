"""Least squares on the correspondences that agree with a planar pose, again and again (paper III-E, end)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import loop

Array64 = NDArray[np.float64]


@loop
def refine_planar_pose(
    source: Array64, target: Array64, yaws: Array64, tolerance: float, yaw_tolerance: float, rounds: int,
    pose: Array64, agree: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Move `pose` (yaw, x, y) to the least squares pose of those that agree with it, `rounds` times.

    source (n, 2) and target (n, 2) are corresponding points in metres, yaws (n,) what each implies in radians. One
    agrees where the pose brings it nearer than `tolerance` and its yaw differs by less than `yaw_tolerance`. `agree`
    (n,) says which did with the pose before the last one, or with that at which fewer than two agreed, where it stays.
    """
    for _ in range(rounds):
        cosine, sine, count = np.cos(pose[0]), np.sin(pose[0]), 0
        ax, ay, bx, by = 0.0, 0.0, 0.0, 0.0
        for k in range(len(source)):
            dx = cosine * source[k, 0] - sine * source[k, 1] + pose[1] - target[k, 0]
            dy = sine * source[k, 0] + cosine * source[k, 1] + pose[2] - target[k, 1]
            turned = abs((yaws[k] - pose[0] + np.pi) % (2.0 * np.pi) - np.pi)
            agree[k] = (np.sqrt(dx * dx + dy * dy) < tolerance) & (turned < yaw_tolerance)
            if agree[k]:
                count += 1
                ax, ay, bx, by = ax + source[k, 0], ay + source[k, 1], bx + target[k, 0], by + target[k, 1]
        if count < 2:
            return
        ax, ay, bx, by = ax / count, ay / count, bx / count, by / count
        along, across = 0.0, 0.0
        for k in range(len(source)):
            if agree[k]:
                sx, sy, tx, ty = source[k, 0] - ax, source[k, 1] - ay, target[k, 0] - bx, target[k, 1] - by
                along += sx * tx + sy * ty
                across += sx * ty - sy * tx
        pose[0] = np.arctan2(across, along)
        cosine, sine = np.cos(pose[0]), np.sin(pose[0])
        pose[1], pose[2] = bx - (cosine * ax - sine * ay), by - (sine * ax + cosine * ay)
