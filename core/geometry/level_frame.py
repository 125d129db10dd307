"""LevelFrame: the frame in which a place is described, upright by gravity and divided by the scene scale.

Its points relate to those of the submap by a similarity: p_submap = scale * rotation @ p_level + translation. A
similarity is no rigid transform, so it has a type of its own; poses between submaps stay rigid.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from revisit.core.errors import BadTransform
from revisit.core.geometry import se3

Array64 = NDArray[np.float64]


@dataclass(frozen=True)
class LevelFrame:
    """The frame of a described place, seen from the frame of its submap.

    rotation (3, 3) and translation (3,) in metres turn and move the upright axes into the submap frame. The lengths of
    the submap are divided by scale > 0. Raises BadTransform for other shapes, non-finite numbers or a scale <= 0.
    """

    rotation: Array64 = field(default_factory=lambda: np.eye(3))
    translation: Array64 = field(default_factory=lambda: np.zeros(3))
    scale: float = 1.0

    def __post_init__(self) -> None:
        if self.rotation.shape != (3, 3) or self.translation.shape != (3,):
            raise BadTransform("a level frame needs a rotation (3, 3) and a translation (3,)")
        if not (np.isfinite(self.rotation).all() and np.isfinite(self.translation).all()):
            raise BadTransform("the level frame holds NaN or infinity")
        if not 0.0 < self.scale < np.inf:
            raise BadTransform(f"the scale of a level frame must be positive and finite, got {self.scale}")

    @classmethod
    def from_upright(cls, T_submap_upright: se3.Matrix4, scale: float) -> LevelFrame:
        """The frame whose axes are those of the rigid `T_submap_upright` (4, 4), with lengths divided by `scale`."""
        return cls(T_submap_upright[:3, :3].copy(), T_submap_upright[:3, 3].copy(), float(scale))

    @classmethod
    def from_similarity(cls, submap_level: ArrayLike) -> LevelFrame:
        """The frame of a similarity (4, 4) as `similarity` gives it. Raises BadTransform for anything else."""
        matrix = np.array(submap_level, dtype=np.float64)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise BadTransform(f"a similarity must be (4, 4) and finite, got {matrix.shape}")
        with np.errstate(over="ignore", under="ignore"):
            scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
        if not 1e-6 < scale < 1e6:
            raise BadTransform("the similarity is a reflection or has no usable scale")
        matrix[:3, :3] /= scale
        return cls.from_upright(se3.validated(matrix), scale)

    @property
    def T_submap_upright(self) -> se3.Matrix4:
        """The rigid part (4, 4): from the upright axes, in metres, into the submap frame."""
        return se3.from_rotation_translation(self.rotation, self.translation)

    @property
    def similarity(self) -> Array64:
        """The homogeneous matrix (4, 4) that maps level points to submap points, as blobs store it."""
        return se3.from_rotation_translation(self.rotation * self.scale + 0.0, self.translation + 0.0)

    def points_to_submap(self, points: NDArray[np.floating]) -> Array64:
        """Level `points` (n, 3) in the submap frame, metres."""
        return np.asarray(points @ (self.rotation * self.scale).T + self.translation)

    def points_to_level(self, points: NDArray[np.floating]) -> Array64:
        """Submap `points` (n, 3), metres, in the level frame."""
        return np.asarray((points - self.translation) @ self.rotation / self.scale)

    def normals_to_submap(self, normals: NDArray[np.floating]) -> Array64:
        """Directions (n, 3) of the level frame in the submap frame; their lengths stay."""
        return np.asarray(normals @ self.rotation.T)

    def pose_to_submap(self, T_level_body: se3.Matrix4) -> se3.Matrix4:
        """The rigid pose (4, 4) of a body, given in the level frame, as a pose in the submap frame: T_submap_body."""
        return self.T_submap_upright @ _stretched(T_level_body, self.scale)

    def pose_to_level(self, T_submap_body: se3.Matrix4) -> se3.Matrix4:
        """The rigid pose (4, 4) of a body, given in the submap frame, as a pose in the level frame: T_level_body."""
        return _stretched(se3.inverse(self.T_submap_upright) @ T_submap_body, 1.0 / self.scale)

    def covariance_to_submap(self, covariance: Array64) -> Array64:
        """The covariance (6, 6) of a tangent (x, y, z, rx, ry, rz) of the level frame, in that of the submap frame."""
        adjoint = se3.adjoint(self.T_submap_upright) @ np.diag([*[self.scale] * 3, *[1.0] * 3])
        return np.asarray(adjoint @ covariance @ adjoint.T)


def motion_between_submaps(T_match_query: se3.Matrix4, query: LevelFrame, match: LevelFrame) -> se3.Matrix4:
    """The rigid motion (4, 4) from the query's submap frame to the match's, of one between their level frames.

    Both frames must have the same scale: a rigid motion between frames of different scale does not exist.
    """
    return match.pose_to_submap(T_match_query) @ se3.inverse(query.T_submap_upright)


def motion_between_levels(T_match_query: se3.Matrix4, query: LevelFrame, match: LevelFrame) -> se3.Matrix4:
    """The rigid motion (4, 4) between two level frames, of one between their submap frames."""
    return match.pose_to_level(T_match_query @ query.T_submap_upright)


def _stretched(transform: se3.Matrix4, factor: float) -> se3.Matrix4:
    """The rigid transform whose translation is `factor` times that of `transform`."""
    return se3.from_rotation_translation(transform[:3, :3], transform[:3, 3] * factor)
