"""The kernels of verification by torch: on a GPU, or on the processor to compare them (docs/decisions/0208).

Poses and sums are float64, searches float32, as in the compiled kernels, so that counterparts are the same and poses
differ by the order of sums alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from revisit.core.device.compiled import CompiledKernels
from revisit.core.device.contract import (
    Agreement,
    Alignment,
    AlignmentRules,
    Array64,
    Contact,
    ContactNumbers,
    ContactRules,
    Correlation,
    Shifts,
)
from revisit.core.device.torch_arrays import moved_there
from revisit.core.device.torch_patches import NOWHERE, Tables
from revisit.core.device.torch_plans import agreements

_SMALLEST_STEP_M, _SMALLEST_STEP_RAD = 2e-3, 1e-4
_DAMPING = 1e-6
_MOST_COLUMNS = 1 << 20
"""Columns from the origin in either direction that a key can name; none is seen beyond."""


def open_torch_kernels(name: str) -> TorchKernels:
    """The kernels of the torch device `name`: "cpu", "cuda" or "cuda:N". Raises ValueError where there is none.

    Nothing is reserved on it yet.
    """
    try:
        where = torch.device(name)
    except RuntimeError as error:
        raise ValueError("no name of a device; cpu, cuda, cuda:N or torch-cpu") from error
    if where.type not in ("cpu", "cuda"):
        raise ValueError("kernels run on cpu, cuda, cuda:N or torch-cpu")  # others lack numbers of 64 bits
    there = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if where.type == "cuda" and (where.index or 0) >= there:
        raise ValueError(f"torch {torch.__version__} finds {there} such devices on this machine")
    return TorchKernels(where)


class TorchKernels:
    """`Kernels` on a device of torch: the jobs of a call at once."""

    def __init__(self, where: torch.device) -> None:
        """Everything is computed on `where`, a device of torch, but for surfaces too wide for a grid of columns."""
        self.where = where
        self._compiled = CompiledKernels()

    def align(self, jobs: Sequence[Alignment], rules: AlignmentRules) -> list[Array64]:
        """See `Kernels`."""
        if not all(len(job.patches.grid) for job in jobs) or not jobs:
            return self._compiled.align(jobs, rules)
        poses = self._moved_there(np.stack([job.T_start for job in jobs]))
        tables = Tables.of([job.patches for job in jobs], self.where)
        points, there = self._padded([job.points for job in jobs])
        normals, _ = self._padded([job.normals for job in jobs])
        under_way = torch.arange(len(jobs), device=self.where)
        for _ in range(rules.rounds):
            some = tables.of_jobs(under_way)
            hessian, gradient, pairs = _normal_equations(
                poses[under_way], points[under_way], normals[under_way], there[under_way], some, rules
            )
            enough = pairs >= rules.fewest
            under_way, step = under_way[enough], _solved(hessian[enough], gradient[enough])
            poses[under_way] = _exp(step) @ poses[under_way]
            tiny = (step[:, :3].norm(dim=1) < _SMALLEST_STEP_M) & (step[:, 3:].norm(dim=1) < _SMALLEST_STEP_RAD)
            under_way = under_way[~tiny]
            if not len(under_way):
                break
        return list(poses.cpu().numpy())

    def touch(self, jobs: Sequence[Contact], rules: ContactRules) -> list[ContactNumbers]:
        """See `Kernels`."""
        if not all(len(job.patches.grid) for job in jobs) or not jobs:
            return self._compiled.touch(jobs, rules)
        tables = Tables.of([job.patches for job in jobs], self.where)
        points, there = self._padded([job.points for job in jobs])
        normals, _ = self._padded([job.normals for job in jobs])
        poses = self._moved_there(np.stack([job.T_other_points for job in jobs]))
        moved, turned = _moved(poses, points, normals)
        standing = self._moved_there(np.array([job.standing for job in jobs]))
        seen = there & (torch.arange(points.shape[1], device=self.where) < standing[:, None])
        seen &= self._in_seen_columns(moved, [job.slots for job in jobs], rules.column_edge)
        touching, distances, planes = _touching(moved, turned, there, tables, rules)
        counts = torch.stack([seen.sum(1), (seen & touching).sum(1), touching.sum(1)], dim=1)
        jacobian = _jacobian(moved, planes) * touching[..., None]
        information = jacobian.transpose(1, 2) @ jacobian
        squares = (distances * distances * touching).sum(1)
        parts = (part.cpu().numpy() for part in (counts, squares, information))
        return [ContactNumbers(count, float(square), info) for count, square, info in zip(*parts, strict=True)]

    def share(self, jobs: Sequence[Shifts], rules: ContactRules) -> list[NDArray[np.int64]]:
        """See `Kernels`."""
        poses = [np.tile(np.eye(4), (len(job.shifts), 1, 1)) for job in jobs]
        for of_job, job in zip(poses, jobs, strict=True):
            of_job[:, :3, 3] = job.shifts
        contacts = [
            Contact(job.points, job.normals, len(job.points), pose, job.patches, job.slots)
            for of_job, job in zip(poses, jobs, strict=True)
            for pose in of_job
        ]
        found = iter(self.touch(contacts, rules))
        return [np.array([next(found).counts[:2] for _ in job.shifts]).reshape(-1, 2) for job in jobs]

    def correlate(self, jobs: Sequence[Correlation], pixel: float) -> list[list[Agreement]]:
        """See `Kernels`."""
        return agreements(jobs, pixel, self.where)

    def _moved_there(self, array: NDArray[np.generic]) -> Tensor:
        return moved_there(array, self.where)

    def _padded(self, clouds: Sequence[Array64]) -> tuple[Tensor, Tensor]:
        """Clouds (n, 3) side by side (j, most, 3), and where there are points of them (j, most)."""
        counts = np.array([len(cloud) for cloud in clouds])
        padded = np.zeros((len(clouds), max(int(counts.max()), 1), 3))
        for row, cloud in zip(padded, clouds, strict=True):
            row[: len(cloud)] = cloud
        return self._moved_there(padded), self._moved_there(np.arange(padded.shape[1]) < counts[:, None])

    def _in_seen_columns(self, points: Tensor, slots: Sequence[NDArray[np.int32]], edge: float) -> Tensor:
        """Which of `points` (j, n, 3) stand in a column that is entered in the slots of their job."""
        keys = []
        for number, entered in enumerate(slots):
            used = entered[entered[:, 0] != np.iinfo(np.int32).min].astype(np.int64)
            keys.append(_column_keys(used[:, 0], used[:, 1], np.int64(number)))
        known = torch.sort(self._moved_there(np.concatenate(keys))).values
        columns = torch.floor(points[..., :2] / edge).clamp(-_MOST_COLUMNS, _MOST_COLUMNS - 1).long()
        numbers = torch.arange(len(slots), device=self.where)[:, None]
        asked = _column_keys(columns[..., 0], columns[..., 1], numbers).contiguous()
        if not len(known):
            return torch.zeros_like(asked, dtype=torch.bool)
        places: Tensor = torch.searchsorted(known, asked).clamp(max=len(known) - 1)
        return torch.eq(known[places], asked)


def _column_keys(x: Any, y: Any, job: Any) -> Any:
    """One whole number for each column (x, y) of a job; arrays or tensors."""
    return (job * (2 * _MOST_COLUMNS) + x + _MOST_COLUMNS) * (2 * _MOST_COLUMNS) + y + _MOST_COLUMNS


def _moved(poses: Tensor, points: Tensor, normals: Tensor) -> tuple[Tensor, Tensor]:
    """Points and normals (j, n, 3) moved by `poses` (j, 4, 4)."""
    turns = poses[:, :3, :3].transpose(1, 2)
    return points @ turns + poses[:, None, :3, 3], normals @ turns


def _planes(rows: Tensor, tables: Tables) -> tuple[Tensor, Tensor]:
    """Positions and normals (j, n, 3) of the records of these rows; those of NOWHERE are of any record."""
    records = tables.records[rows.clamp(min=0)].double()
    return records[..., :3], records[..., 4:7]


def _touching(
    points: Tensor, normals: Tensor, there: Tensor, tables: Tables, rules: ContactRules
) -> tuple[Tensor, Tensor, Tensor]:
    """Which points touch (j, n), their distances to the planes (j, n), and the normals (j, n, 3) of these."""
    rows = tables.nearest(points, there, rules.edge, rules.reach)
    positions, planes = _planes(rows, tables)
    distances, facing = ((points - positions) * planes).sum(-1), (normals * planes).sum(-1)
    touching = (rows != NOWHERE) & (distances.abs() < rules.plane_distance) & (facing > rules.facing_alike)
    return touching, distances, planes


def _normal_equations(
    poses: Tensor, points: Tensor, normals: Tensor, there: Tensor, tables: Tables, rules: AlignmentRules
) -> tuple[Tensor, Tensor, Tensor]:
    """Hessian (j, 6, 6), gradient (j, 6) and number of pairs (j,) of a step from `poses` (j, 4, 4)."""
    moved, turned = _moved(poses, points, normals)
    rows = tables.nearest(moved, there, rules.edge, rules.reach)
    positions, planes = _planes(rows, tables)
    pair = (rows != NOWHERE) & ((turned * planes).sum(-1) > rules.facing_alike)
    residuals = ((moved - positions) * planes).sum(-1)
    weights = pair / (1.0 + (residuals / rules.robust) ** 2) ** 2
    jacobian = _jacobian(moved, planes)
    weighted = (jacobian * weights[..., None]).transpose(1, 2)
    return weighted @ jacobian, (weighted @ residuals[..., None])[..., 0], pair.sum(1)


def _jacobian(points: Tensor, planes: Tensor) -> Tensor:
    """Derivatives (j, n, 6) of the distances of `points` to planes with these normals by the tangent of the pose."""
    return torch.cat([planes, torch.linalg.cross(points, planes)], dim=-1)


def _solved(hessian: Tensor, gradient: Tensor) -> Tensor:
    """The damped Gauss-Newton steps (j, 6)."""
    damping = _DAMPING / 6.0 * hessian.diagonal(dim1=1, dim2=2).sum(1)
    damped = hessian + damping[:, None, None] * torch.eye(6, dtype=hessian.dtype, device=hessian.device)
    steps: Tensor = torch.linalg.solve_ex(damped, -gradient[..., None])[0]
    return steps[..., 0]


def _exp(tangents: Tensor) -> Tensor:
    """The motions (j, 4, 4) of tangents (j, 6), as `se3.exp` says."""
    shift, turn = tangents[:, :3], tangents[:, 3:]
    angle = turn.norm(dim=1)[:, None, None]
    small, safe = angle < 1e-8, angle.clamp(min=1e-8)
    a = torch.where(small, 1.0, torch.sin(safe) / safe)
    b = torch.where(small, 0.5, 2.0 * (torch.sin(0.5 * safe) / safe) ** 2)
    c = torch.where(small, 1.0 / 6.0, (safe - torch.sin(safe)) / safe**3)
    hat = torch.zeros(len(tangents), 3, 3, dtype=tangents.dtype, device=tangents.device)
    for row, column, axis in ((2, 1, 0), (0, 2, 1), (1, 0, 2)):
        hat[:, row, column], hat[:, column, row] = turn[:, axis], -turn[:, axis]
    one, square = torch.eye(3, dtype=tangents.dtype, device=tangents.device), hat @ hat
    motion = torch.eye(4, dtype=tangents.dtype, device=tangents.device).repeat(len(tangents), 1, 1)
    motion[:, :3, :3] = one + a * hat + b * square
    motion[:, :3, 3] = ((one + b * hat + c * square) @ shift[..., None])[..., 0]
    return motion
