"""Rigid transforms as 4x4 float64 matrices, named `T_target_source`: p_target = T_target_source @ p_source.

Tangent vectors are (6,) as (x, y, z, rx, ry, rz), metres and radians.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from revisit.core.errors import BadTransform

Matrix4 = NDArray[np.float64]

# Any place on Earth in any usual frame is nearer; farther is a broken pose, and would overflow later steps.
MAX_TRANSLATION_M = 1e8


def from_rotation_translation(rotation: ArrayLike, translation: ArrayLike) -> Matrix4:
    """The transform with the (3, 3) `rotation` and the (3,) `translation` in metres."""
    transform = np.eye(4)
    transform[:3, :3] = rotation
    transform[:3, 3] = translation
    return transform


def from_quaternion(quaternion_xyzw: ArrayLike, translation: ArrayLike) -> Matrix4:
    """The transform with a quaternion (x, y, z, w) of norm 1 within 1e-3, which is normalised.

    Raises BadTransform for another norm or for non-finite numbers.
    """
    quaternion = np.asarray(quaternion_xyzw, dtype=np.float64)
    position = np.asarray(translation, dtype=np.float64)
    if quaternion.shape != (4,) or position.shape != (3,):
        raise BadTransform("a pose needs a quaternion (x, y, z, w) and a translation (x, y, z)")
    if not (np.isfinite(quaternion).all() and np.isfinite(position).all()):
        raise BadTransform("the pose holds NaN or infinity")
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1.0) > 1e-3:
        raise BadTransform(f"the quaternion (x, y, z, w; w is the last) must have norm 1 within 0.001, got {norm:.6g}")
    x, y, z, w = quaternion / norm
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return from_rotation_translation(rotation, position)


def to_quaternion(transform: Matrix4) -> NDArray[np.float64]:
    """The unit quaternion (x, y, z, w) with w >= 0 of a transform's rotation."""
    (a, b, c), (d, e, f), (g, h, i) = transform[:3, :3].tolist()
    # 4 q q^T, row by row: the row of the largest component is divided by no small number (Shepperd 1978).
    rows = (
        (1 + a - e - i, b + d, c + g, h - f),
        (b + d, 1 + e - a - i, f + h, c - g),
        (c + g, f + h, 1 + i - a - e, d - b),
        (h - f, c - g, d - b, 1 + a + e + i),
    )
    largest = max(range(4), key=lambda row: rows[row][row])
    x, y, z, w = rows[largest]
    norm = math.copysign(math.sqrt(x * x + y * y + z * z + w * w), w)
    return np.array([x / norm, y / norm, z / norm, w / norm])


def from_yaw(yaw: float, translation: ArrayLike = (0.0, 0.0, 0.0)) -> Matrix4:
    """The rotation by `yaw` radians about z, followed by `translation`."""
    c, s = np.cos(yaw), np.sin(yaw)
    return from_rotation_translation([[c, -s, 0], [s, c, 0], [0, 0, 1]], translation)


def validated(transform: ArrayLike) -> Matrix4:
    """`transform` as a (4, 4) float64 rigid motion, its rotation re-orthonormalised.

    Accepts (4, 4) or (3, 4). Raises BadTransform for another shape, non-finite numbers, a rotation that is
    more than 1e-3 from orthonormal, a reflection, or a translation beyond 100,000 km.
    """
    matrix = np.asarray(transform, dtype=np.float64)
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])
    if matrix.shape != (4, 4):
        raise BadTransform(f"a transform must be (4, 4) or (3, 4), got {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise BadTransform("the transform holds NaN or infinity")
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-9:
        raise BadTransform("the last row of a transform must be 0 0 0 1")
    if np.abs(matrix[:3, 3]).max() > MAX_TRANSLATION_M:
        raise BadTransform(f"the translation exceeds {MAX_TRANSLATION_M:.0f} m")
    u, singular, vt = np.linalg.svd(np.clip(matrix[:3, :3], -2.0, 2.0))
    if np.abs(singular - 1.0).max() > 1e-3:
        raise BadTransform("the rotation is not orthonormal")
    if np.linalg.det(u @ vt) < 0:
        raise BadTransform("the rotation is a reflection")
    return from_rotation_translation(u @ vt, matrix[:3, 3])


def inverse(transform: Matrix4) -> Matrix4:
    """T_source_target of T_target_source."""
    rotation = transform[:3, :3].T
    return from_rotation_translation(rotation, -rotation @ transform[:3, 3])


def apply(transform: Matrix4, points: NDArray[np.floating]) -> NDArray[np.float64]:
    """The (n, 3) `points` of the source frame in the target frame."""
    return np.asarray(points @ transform[:3, :3].T + transform[:3, 3])


def adjoint(transform: Matrix4) -> NDArray[np.float64]:
    """The (6, 6) matrix with T exp(xi) = exp(adjoint @ xi) T, for tangents (x, y, z, rx, ry, rz)."""
    rotation = transform[:3, :3]
    found = np.zeros((6, 6))
    found[:3, :3] = found[3:, 3:] = rotation
    found[:3, 3:] = _hat(transform[:3, 3]) @ rotation
    return found


def rotation_angle(transform: Matrix4) -> float:
    """The angle of the rotation in radians, in [0, pi]."""
    rotation = transform[:3, :3]
    skew = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    return float(np.arctan2(np.linalg.norm(skew), np.trace(rotation) - 1.0))


def yaw(transform: Matrix4) -> float:
    """The heading of the source x axis seen in the target's horizontal plane, radians in (-pi, pi]."""
    return float(np.arctan2(transform[1, 0], transform[0, 0]))


def exp(tangent: ArrayLike) -> Matrix4:
    """The transform exp(tangent) of se(3), tangent (x, y, z, rx, ry, rz)."""
    xi = np.asarray(tangent, dtype=np.float64)
    rho, phi = xi[:3], xi[3:]
    angle = float(np.linalg.norm(phi))
    k = _hat(phi)
    if angle < 1e-8:
        return from_rotation_translation(np.eye(3) + k, rho + 0.5 * k @ rho)
    # 2 sin^2(angle / 2) instead of 1 - cos(angle), which loses every digit for small angles.
    a, b, c = np.sin(angle) / angle, 2 * (np.sin(angle / 2) / angle) ** 2, (angle - np.sin(angle)) / angle**3
    return from_rotation_translation(np.eye(3) + a * k + b * k @ k, (np.eye(3) + b * k + c * k @ k) @ rho)


def log(transform: Matrix4) -> NDArray[np.float64]:
    """The tangent (6,) whose exponential is `transform`."""
    x, y, z, w = to_quaternion(transform)
    vector = np.array([x, y, z])
    sine = float(np.linalg.norm(vector))
    phi = vector * (2.0 * np.arctan2(sine, w) / sine) if sine > 1e-12 else 2.0 * vector
    half = 0.5 * float(np.linalg.norm(phi))
    k = _hat(phi)
    # (1 - half cot half) / angle^2: finite at pi, and 1/12 in the limit of no rotation.
    factor = (1.0 - half * np.cos(half) / np.sin(half)) / (4.0 * half * half) if half > 1e-4 else 1.0 / 12.0
    inverse_left = np.eye(3) - 0.5 * k + factor * k @ k
    return np.concatenate([inverse_left @ transform[:3, 3], phi])


def interpolated(first: Matrix4, second: Matrix4, share: float) -> Matrix4:
    """The pose after a share of the screw motion from one pose to another: 0 is the first, 1 the second."""
    return np.asarray(first @ exp(share * log(inverse(first) @ second)))


def _hat(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def pose_row(T_target_source: Matrix4) -> tuple[float, ...]:
    """A (4, 4) transform as a row of a database holds it: 16 floats, row by row."""
    return tuple(np.asarray(T_target_source, dtype=np.float64).ravel().tolist())


def pose_matrix(row: Sequence[float]) -> Matrix4:
    """The (4, 4) float64 transform of `pose_row`."""
    return np.asarray(row, dtype=np.float64).reshape(4, 4)


def position_row(position: NDArray[np.float64]) -> tuple[float, float, float]:
    """A position (3,) in metres as a row of a database holds it."""
    return float(position[0]), float(position[1]), float(position[2])
