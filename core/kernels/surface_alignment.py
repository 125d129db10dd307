"""The point-to-plane ICP that brings two surfaces together (paper III-E, end)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.kernels.loops import inlined, inner, loop
from revisit.core.kernels.normal_equations import CHUNK, add_normal_equations
from revisit.core.kernels.patches import Patches, two_nearest

Array64 = NDArray[np.float64]

_SMALLEST_STEP_M, _SMALLEST_STEP_RAD = 2e-3, 1e-4
_DAMPING = 1e-6
_WIDER = 1.1  # how much farther ICP looks than it reaches, so that a point without a counterpart is not asked again


def aligned(
    T_start: Array64, points: Array64, normals: Array64, patches: Patches, edge: float, reach: float, rounds: int,
    facing_alike: float, robust: float, fewest: int,
) -> Array64:  # fmt: skip
    """T (4, 4) after up to `rounds` Gauss-Newton steps of point-to-plane ICP from `T_start`.

    Each point counts with its nearest counterpart nearer than `reach` whose normal has a cosine above `facing_alike`
    with its own, by the weight 1 / (1 + (residual / robust)^2)^2. Ends with fewer than `fewest` pairs or a tiny step.

    A point that has moved by less than half the difference of the distances to its nearest and next point since it was
    looked for still has the same nearest one: later steps are small, and most points are not looked for again.
    """
    pose, found, known = T_start.copy(), np.full(len(points), -1, np.int32), np.full((len(points), 4), np.nan)
    sums = np.empty((9, CHUNK)), np.empty((6, 6)), np.empty(6)
    _align(points, normals, patches, edge, reach, rounds, facing_alike, robust, fewest, found, known, *sums, pose)
    return pose


@loop
def _align(
    points: Array64, normals: Array64, patches: Patches, edge: float, reach: float, rounds: int, facing_alike: float,
    robust: float, fewest: int, found: NDArray[np.int32], known: Array64, rows: Array64, hessian: Array64,
    gradient: Array64, pose: Array64,
) -> None:  # fmt: skip
    """Move `pose`. `rows` (9, CHUNK), `hessian` and `gradient` are for its use.

    Of each point `found` (n,) is the row of its nearest patch, -1 for none, and `known` (n, 4) where it was when that
    was looked for, and the square of how far it may go.
    """
    records, places, keys, grid = patches.records, patches.places, patches.keys, patches.grid
    x_low, y_low, width, depth = patches.low[0], patches.low[1], patches.shape[0], patches.shape[1]
    for _ in range(rounds):
        hessian[:], gradient[:] = 0.0, 0.0
        pairs, filled = 0, 0
        for n in range(len(points)):
            x, y, z = _moved(pose, points[n, 0], points[n, 1], points[n, 2], 1.0)
            moved = (x - known[n, 0]) ** 2 + (y - known[n, 1]) ** 2 + (z - known[n, 2]) ** 2
            if not moved < known[n, 3]:
                found[n], nearest, following = two_nearest(
                    places, keys, grid, x_low, y_low, width, depth, edge, _WIDER * reach, x, y, z
                )
                # where there is none, it may come as near as `reach` before it is looked for again
                margin = 0.5 * (following - nearest) if found[n] >= 0 else (_WIDER - 1.0) * reach
                known[n, 0], known[n, 1], known[n, 2], known[n, 3] = x, y, z, margin**2
            if found[n] < 0:
                continue
            mx, my, mz = _moved(pose, normals[n, 0], normals[n, 1], normals[n, 2], 0.0)
            patch = records[found[n]]
            nx, ny, nz = float(patch[4]), float(patch[5]), float(patch[6])
            dx, dy, dz = x - patch[0], y - patch[1], z - patch[2]
            if dx * dx + dy * dy + dz * dz >= reach * reach or mx * nx + my * ny + mz * nz <= facing_alike:
                continue
            residual = dx * nx + dy * ny + dz * nz
            damped = 1.0 / (1.0 + (residual / robust) ** 2)
            rows[0, filled], rows[1, filled], rows[2, filled] = nx, ny, nz
            rows[3, filled], rows[4, filled], rows[5, filled] = y * nz - z * ny, z * nx - x * nz, x * ny - y * nx
            rows[6, filled], rows[7, filled] = residual, damped * damped
            filled += 1
            if filled == CHUNK:
                add_normal_equations(rows, filled, hessian, gradient)
                pairs, filled = pairs + filled, 0
        add_normal_equations(rows, filled, hessian, gradient)
        if pairs + filled < fewest or _stepped(pose, hessian, gradient):
            break


@inner
def _stepped(pose: Array64, hessian: Array64, gradient: Array64) -> bool:
    """Whether the step of the normal equations, by which `pose` (4, 4) moves, was a tiny one."""
    _solve(hessian, gradient)
    _step(pose, gradient)
    shift = np.sqrt(gradient[0] ** 2 + gradient[1] ** 2 + gradient[2] ** 2)
    turn = np.sqrt(gradient[3] ** 2 + gradient[4] ** 2 + gradient[5] ** 2)
    return bool(shift < _SMALLEST_STEP_M and turn < _SMALLEST_STEP_RAD)


@inlined
def _moved(pose: Array64, x: float, y: float, z: float, shift: float) -> tuple[float, float, float]:
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + shift * pose[0, 3],
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + shift * pose[1, 3],
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + shift * pose[2, 3],
    )


@inner
def _solve(hessian: Array64, gradient: Array64) -> None:
    """The damped Gauss-Newton step in place of `gradient` (6,), from the lower half of `hessian` (6, 6): Cholesky."""
    damping = 0.0
    for a in range(6):
        damping += _DAMPING * hessian[a, a] / 6.0
    for a in range(6):
        hessian[a, a] += damping
        for b in range(a + 1):
            total = hessian[a, b]
            for k in range(b):
                total -= hessian[a, k] * hessian[b, k]
            hessian[a, b] = np.sqrt(total) if a == b else total / hessian[b, b]
    for a in range(6):
        for k in range(a):
            gradient[a] -= hessian[a, k] * gradient[k]
        gradient[a] /= hessian[a, a]
    for a in range(5, -1, -1):
        for k in range(a + 1, 6):
            gradient[a] -= hessian[k, a] * gradient[k]
        gradient[a] /= hessian[a, a]
    for a in range(6):
        gradient[a] = -gradient[a]


@inner
def _step(pose: Array64, tangent: Array64) -> None:
    """`pose` (4, 4) becomes exp(tangent) pose, as `se3.exp` says, tangent (x, y, z, rx, ry, rz)."""
    tx, ty, tz, rx, ry, rz = tangent[0], tangent[1], tangent[2], tangent[3], tangent[4], tangent[5]
    angle = np.sqrt(rx * rx + ry * ry + rz * rz)
    a, b, c = 1.0, 0.5, 1.0 / 6.0
    if angle >= 1e-8:
        a, b = np.sin(angle) / angle, 2.0 * (np.sin(0.5 * angle) / angle) ** 2
        c = (angle - np.sin(angle)) / angle**3
    for j in range(4):  # the rotation of a vector: 1 + a hat + b hat^2, with hat v = r x v
        x, y, z = pose[0, j], pose[1, j], pose[2, j]
        pose[0, j], pose[1, j], pose[2, j] = _turned(rx, ry, rz, x, y, z, a, b)
    x, y, z = _turned(rx, ry, rz, tx, ty, tz, b, c)
    pose[0, 3] += x
    pose[1, 3] += y
    pose[2, 3] += z


@inlined
def _turned(
    rx: float, ry: float, rz: float, x: float, y: float, z: float, once: float, twice: float
) -> tuple[float, float, float]:
    """v + once (r x v) + twice (r x (r x v))."""
    hx, hy, hz = ry * z - rz * y, rz * x - rx * z, rx * y - ry * x
    gx, gy, gz = ry * hz - rz * hy, rz * hx - rx * hz, rx * hy - ry * hx
    return x + once * hx + twice * gx, y + once * hy + twice * gy, z + once * hz + twice * gz
