"""Normals of surfaces by torch: the direction of least variance, of all points at once (paper III-B 1)."""

from __future__ import annotations

import torch
from torch import Tensor

from lab.gpu.replay import replayed
from revisit.core.kernels.oriented_normals import NEGLIGIBLE, NORMAL_PRIOR

_SWEEPS = 6
"""Each doubles the digits that are right; the compiled ones stop where nothing is left to turn, mostly after four."""


def oriented_normals(covariances: Tensor, views: Tensor) -> Tensor:
    """Unit normals (n, 3) float32 of `covariances` (n, 3, 3) and `views` (n, 3), as the compiled ones.

    By Jacobi's method in the same order of steps: a library's solver is made for few large matrices.
    """
    (normals,) = _oriented(covariances, views)
    return normals


@replayed
def _oriented(covariances: Tensor, views: Tensor) -> tuple[Tensor]:
    x, y, z = views.unbind(1)
    view = views / (torch.sqrt(x * x + y * y + z * z) + 1e-12)[:, None]
    matrix, turns = _with_prior(covariances, view), torch.eye(3, dtype=views.dtype, device=views.device)
    rows = [matrix[:, i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    axes = list(turns.repeat(len(views), 1, 1).unbind(2))
    for _ in range(_SWEEPS):
        _clear_diagonal(rows)
        for p, q in ((0, 1), (0, 2), (1, 2)):
            _rotate(rows, axes, p, q)
    least = torch.where((rows[1] < rows[0])[:, None], axes[1], axes[0])
    normals = torch.where((rows[2] < torch.minimum(rows[0], rows[1]))[:, None], axes[2], least)
    along = normals[:, 0] * view[:, 0] + normals[:, 1] * view[:, 1] + normals[:, 2] * view[:, 2]
    return ((torch.where(along < 0.0, -1.0, 1.0)[:, None] * normals).float(),)


def _with_prior(covariances: Tensor, view: Tensor) -> Tensor:
    """The matrices (n, 3, 3) of trace 1, with the prior for the viewing direction."""
    spread = covariances[:, 0, 0] + covariances[:, 1, 1] + covariances[:, 2, 2] + 1e-9
    prior = NORMAL_PRIOR * view[:, :, None] * view[:, None]
    one = NORMAL_PRIOR * torch.eye(3, dtype=view.dtype, device=view.device)
    return covariances / spread[:, None, None] - prior + one


def _clear_diagonal(rows: list[Tensor]) -> None:
    """Make entries zero, in place, that are negligible beside the diagonals."""
    aside = rows[3] ** 2 + rows[4] ** 2 + rows[5] ** 2
    diagonal = aside <= NEGLIGIBLE * (rows[0] ** 2 + rows[1] ** 2 + rows[2] ** 2)
    for a in range(3, 6):
        rows[a] = torch.where(diagonal, 0.0, rows[a])


def _rotate(rows: list[Tensor], axes: list[Tensor], p: int, q: int) -> None:
    """As `kernels.oriented_normals._rotate`: turn so that element (p, q) becomes zero."""
    pq, r = 2 + p + q, 3 - p - q
    rp, rq = 2 + r + p, 2 + r + q
    off, there = rows[pq], rows[pq] != 0.0
    ratio = (rows[q] - rows[p]) / torch.where(there, 2.0 * off, 1.0)
    tangent = 1.0 / (ratio.abs() + torch.sqrt(ratio * ratio + 1.0))
    tangent = torch.where(there, torch.where(ratio < 0.0, -tangent, tangent), 0.0)
    cosine = 1.0 / torch.sqrt(tangent * tangent + 1.0)
    sine = tangent * cosine
    rows[p], rows[q], rows[pq] = rows[p] - tangent * off, rows[q] + tangent * off, torch.zeros_like(off)
    rows[rp], rows[rq] = cosine * rows[rp] - sine * rows[rq], sine * rows[rp] + cosine * rows[rq]
    across, along = sine[:, None], cosine[:, None]
    axes[p], axes[q] = along * axes[p] - across * axes[q], across * axes[p] + along * axes[q]
