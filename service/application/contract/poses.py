"""Poses in rows: 16 floats, row-major."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry.se3 import Matrix4
from revisit.service.application.contract.records import Pose


def pose_row(T_target_source: Matrix4) -> Pose:
    """A (4, 4) transform as it is stored."""
    return tuple(float(value) for value in T_target_source.ravel())


def pose_matrix(pose: Pose) -> Matrix4:
    """The (4, 4) float64 transform of a stored pose."""
    return np.asarray(pose, dtype=np.float64).reshape(4, 4)


def position_row(position: NDArray[np.float64]) -> tuple[float, float, float]:
    """A position (3,) in metres as it is stored."""
    return float(position[0]), float(position[1]), float(position[2])
