"""Errors of a surface against the truth, both ways: accuracy, completeness, F-scores and normals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import open3d as o3d
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from revisit.evaluation.surfaces.zero_level import Mesh

Array = NDArray[np.float32]
Floats = NDArray[np.float64]

THRESHOLDS_M = (0.05, 0.10, 0.20)
CUT_M = 0.5
"""A distance counts as this at most, so that a few far points do not set a mean."""
_NEIGHBOURS = 8
_SAMPLES = 60_000


class Truth(Protocol):
    """The true surface as far as it is known, in the frame of the map."""

    @property
    def samples(self) -> Array:
        """Points (n, 3) on the true surface that the map should hold."""
        ...

    def distances(self, points: Array) -> tuple[Floats, Array]:
        """Distances (m,) of `points` (m, 3) to the true surface, NaN where it is unknown, and its normals (m, 3)."""
        ...


@dataclass(frozen=True)
class TrueTriangles:
    """Truth as triangles (t, 3, 3), all of which a surface may follow; `samples` (n, 3) are the seen points of them."""

    triangles: Array
    samples: Array

    def distances(self, points: Array) -> tuple[Floats, Array]:
        """As `Truth`."""
        scene = _scene(self.triangles.reshape(-1, 3), np.arange(3 * len(self.triangles)).reshape(-1, 3))
        found = scene.compute_closest_points(o3d.core.Tensor.from_numpy(np.ascontiguousarray(points)), nthreads=1)
        gap = np.linalg.norm(found["points"].numpy() - points, axis=1)
        return gap.astype(np.float64), found["primitive_normals"].numpy()


@dataclass(frozen=True)
class HeldOutReturns:
    """Truth as the returns (n, 3) of scans that the map has not seen.

    The true surface near a point is the plane through the eight nearest of them; where fewer lie within CUT_M, it is
    unknown.
    """

    samples: Array

    def distances(self, points: Array) -> tuple[Floats, Array]:
        """As `Truth`."""
        gaps, rows = cKDTree(self.samples).query(points, _NEIGHBOURS, distance_upper_bound=CUT_M)
        known = np.isfinite(gaps[:, -1])
        distance, normals = np.full(len(points), np.nan), np.zeros((len(points), 3), np.float32)
        near = self.samples[rows[known]].astype(np.float64)
        centre = near.mean(axis=1)
        spread = np.einsum("mka,mkb->mab", near - centre[:, None], near - centre[:, None])
        normals[known] = np.linalg.eigh(spread)[1][:, :, 0]
        distance[known] = np.abs(np.einsum("ma,ma->m", points[known] - centre, normals[known]))
        return distance, normals


@dataclass(frozen=True)
class SurfaceError:
    """How far a surface and the truth are from each other. Lengths in metres, angles in degrees, shares 0..1.

    accuracy: from the surface to the truth; completeness: from the truth to the surface, each mean with distances cut
    at CUT_M, and median; precision, recall and f_score at each of THRESHOLDS_M; normal_deg the median angle between a
    face and the true surface next to it.
    """

    accuracy: float
    accuracy_median: float
    completeness: float
    completeness_median: float
    precision: tuple[float, ...]
    recall: tuple[float, ...]
    normal_deg: float

    @property
    def mean(self) -> float:
        """Accuracy and completeness in one number: their mean, metres (the Chamfer distance, halved)."""
        return (self.accuracy + self.completeness) / 2

    @property
    def f_score(self) -> tuple[float, ...]:
        """Harmonic mean of precision and recall at each threshold."""
        pairs = zip(self.precision, self.recall, strict=True)
        return tuple(2 * p * r / max(p + r, 1e-9) for p, r in pairs)


def surface_error(mesh: Mesh, truth: Truth, seed: int = 0, unit_m: float = 1.0) -> SurfaceError:
    """The errors of `mesh` against `truth`, both in lengths of `unit_m` metres; figures are in metres."""
    rng = np.random.default_rng(seed)
    points, normals = _sampled(mesh, _SAMPLES, rng)
    there, true_normals = truth.distances(points)
    known = np.isfinite(there)
    there = np.minimum(there[known] * unit_m, CUT_M)
    back = np.minimum(_distances_to(mesh, _thinned(truth.samples, _SAMPLES, rng)) * unit_m, CUT_M)
    near = there < THRESHOLDS_M[-1]
    cosine = np.abs(np.einsum("ma,ma->m", normals[known], true_normals[known]))[near]
    return SurfaceError(
        accuracy=float(there.mean()), accuracy_median=float(np.median(there)),
        completeness=float(back.mean()), completeness_median=float(np.median(back)),
        precision=tuple(float((there <= one).mean()) for one in THRESHOLDS_M),
        recall=tuple(float((back <= one).mean()) for one in THRESHOLDS_M),
        normal_deg=float(np.degrees(np.median(np.arccos(np.clip(cosine, 0.0, 1.0))))),
    )  # fmt: skip


def mean_error(errors: list[SurfaceError]) -> SurfaceError:
    """The mean of the figures of several surfaces."""

    def mean(name: str) -> float:
        return float(np.mean([getattr(error, name) for error in errors]))

    def means(name: str) -> tuple[float, ...]:
        return tuple(np.mean([getattr(error, name) for error in errors], axis=0).tolist())

    return SurfaceError(
        mean("accuracy"), mean("accuracy_median"), mean("completeness"), mean("completeness_median"),
        means("precision"), means("recall"), mean("normal_deg"),
    )  # fmt: skip


def _sampled(mesh: Mesh, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Points (count, 3) spread evenly over the area of a mesh, and the unit normals (count, 3) of their faces."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]].astype(np.float64) for i in range(3))
    cross = np.cross(b - a, c - a)
    area = np.linalg.norm(cross, axis=1)
    rows = rng.choice(len(area), count, p=area / area.sum())
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    points = a[rows] + u * (b - a)[rows] + v * (c - a)[rows]
    return points.astype(np.float32), (cross[rows] / area[rows, None]).astype(np.float32)


def _distances_to(mesh: Mesh, points: Array) -> Floats:
    """Distances (n,) of `points` (n, 3) to the triangles of a mesh."""
    found = _scene(mesh.vertices, mesh.faces).compute_distance(o3d.core.Tensor.from_numpy(points), nthreads=1)
    return np.asarray(found.numpy(), dtype=np.float64)


def _scene(vertices: Array, faces: NDArray[np.integer]) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    corners = o3d.core.Tensor.from_numpy(np.ascontiguousarray(vertices, dtype=np.float32))
    scene.add_triangles(corners, o3d.core.Tensor.from_numpy(np.ascontiguousarray(faces, dtype=np.uint32)))
    return scene


def _thinned(points: Array, count: int, rng: np.random.Generator) -> Array:
    chosen = points if len(points) <= count else points[rng.choice(len(points), count, replace=False)]
    return np.ascontiguousarray(chosen, dtype=np.float32)
