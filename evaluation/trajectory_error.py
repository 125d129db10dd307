"""The absolute trajectory error (ATE): how far positions are from the truth after the best rigid fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3

Floats = NDArray[np.float64]


def trajectory_error(estimate: Floats, truth: Floats) -> float:
    """Root mean square distance (metres) of positions (n, 3) from the truth (n, 3) after the best rigid fit.

    Raises ValueError for fewer than three.
    """
    if len(estimate) < 3:
        raise ValueError("fewer than three poses to align")
    fitted = se3.apply(rigid_fit(estimate, truth), estimate)
    return float(np.sqrt(np.mean(np.sum((fitted - truth) ** 2, axis=1))))


def rigid_fit(points: Floats, truth: Floats) -> se3.Matrix4:
    """T_truth_points (4, 4) that lays points (n, 3) on the truth (n, 3) with the least squared distances (Umeyama)."""
    u, _, vt = np.linalg.svd((truth - truth.mean(axis=0)).T @ (points - points.mean(axis=0)))
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return se3.from_rotation_translation(rotation, truth.mean(axis=0) - rotation @ points.mean(axis=0))
