"""Many rigid transforms (n, 4, 4) at once, by the conventions of `se3`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3

Array64 = NDArray[np.float64]

_NEARLY_OPPOSITE = -0.999
_SMALL = 1e-4
"""Radians below which series replace quotients of vanishing numbers; their next term is below 1e-17."""


def inverse(transforms: Array64) -> Array64:
    """The inverses (n, 4, 4)."""
    turned = transforms[:, :3, :3].transpose(0, 2, 1)
    return _transforms(turned, -turn(turned, transforms[:, :3, 3]))


def adjoint(transforms: Array64) -> Array64:
    """The (n, 6, 6) matrices with T exp(xi) = exp(adjoint @ xi) T."""
    rotations, out = transforms[:, :3, :3], np.zeros((len(transforms), 6, 6))
    out[:, :3, :3] = out[:, 3:, 3:] = rotations
    out[:, :3, 3:] = hat(transforms[:, :3, 3]) @ rotations
    return out


def exp(tangents: Array64) -> Array64:
    """The transforms exp(tangent) of tangents (n, 6)."""
    rho, phi = tangents[:, :3], tangents[:, 3:]
    squared = np.einsum("ni,ni->n", phi, phi)
    angle, k = np.sqrt(squared), hat(phi)
    safe = np.where(angle > _SMALL, angle, 1.0)
    a = np.where(angle > _SMALL, np.sin(safe) / safe, 1.0 - squared / 6.0)
    b = np.where(angle > _SMALL, 2.0 * (np.sin(0.5 * safe) / safe) ** 2, 0.5 - squared / 24.0)
    c = np.where(angle > _SMALL, (safe - np.sin(safe)) / safe**3, 1.0 / 6.0 - squared / 120.0)
    twice, unit = k @ k, np.eye(3)
    rotations = unit + a[:, None, None] * k + b[:, None, None] * twice
    return _transforms(rotations, turn(unit + b[:, None, None] * k + c[:, None, None] * twice, rho))


def log(transforms: Array64) -> Array64:
    """The tangents (n, 6) whose exponentials are `transforms`."""
    rotations = transforms[:, :3, :3]
    sines = 0.5 * np.stack([
        rotations[:, 2, 1] - rotations[:, 1, 2],
        rotations[:, 0, 2] - rotations[:, 2, 0],
        rotations[:, 1, 0] - rotations[:, 0, 1],
    ], axis=1)  # fmt: skip
    sine, cosine = np.linalg.norm(sines, axis=1), 0.5 * (np.trace(rotations, axis1=1, axis2=2) - 1.0)
    angle = np.arctan2(sine, cosine)
    large = sine > 1e-12
    phi = np.where(large, angle / np.where(large, sine, 1.0), 1.0)[:, None] * sines
    for row in np.flatnonzero(cosine < _NEARLY_OPPOSITE):  # the sines say little of the axis there
        phi[row] = se3.log(transforms[row])[3:]
    half, k = np.where(angle > _SMALL, 0.5 * angle, 1.0), hat(phi)
    factor = np.where(angle > _SMALL, (1.0 - half * np.cos(half) / np.sin(half)) / (4.0 * half**2), 1.0 / 12.0)
    inverse_left = np.eye(3) - 0.5 * k + factor[:, None, None] * (k @ k)
    return np.concatenate([turn(inverse_left, transforms[:, :3, 3]), phi], axis=1)


def inverse_right_jacobian(tangents: Array64) -> Array64:
    """The (n, 6, 6) matrices J with log(exp(tangent) exp(small)) = tangent + J small to first order.

    By its series, which errs by 1e-9 at a rotation of a quarter of a radian, by 2e-5 at one, by 0.1 at half a turn.
    """
    brackets = np.zeros((len(tangents), 6, 6))
    brackets[:, :3, :3] = brackets[:, 3:, 3:] = hat(tangents[:, 3:])
    brackets[:, :3, 3:] = hat(tangents[:, :3])
    twice = brackets @ brackets
    even = twice @ (np.eye(6) / 12.0 + twice @ (np.eye(6) / -720.0 + twice / 30240.0))
    return np.asarray(np.eye(6) + 0.5 * brackets + even)


def _transforms(rotations: Array64, translations: Array64) -> Array64:
    out = np.zeros((len(rotations), 4, 4))
    out[:, :3, :3], out[:, :3, 3], out[:, 3, 3] = rotations, translations, 1.0
    return out


def turn(matrices: Array64, vectors: Array64) -> Array64:
    """The products (n, 3) of matrices (n, 3, 3) with vectors (n, 3)."""
    return np.asarray(np.einsum("nij,nj->ni", matrices, vectors))


def hat(vectors: Array64) -> Array64:
    """The (n, 3, 3) matrices whose products with a vector are the cross products of `vectors` (n, 3) with it."""
    x, y, z = vectors.T
    out = np.zeros((len(vectors), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -z, y, -x
    out[:, 1, 0], out[:, 2, 0], out[:, 2, 1] = z, -y, x
    return out
