"""Surfaces as points with normals, and where one touches another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from revisit.core.config import VerificationConfig
from revisit.core.geometry import se3
from revisit.core.kernels.patches import Patches, patches_of
from revisit.core.kernels.seen_columns import SeenColumns, seen_columns
from revisit.core.kernels.surface_contact import contact_sums, shared_counts, touching_rows
from revisit.core.place import Place
from revisit.core.place.kept import Keeping

Array64 = NDArray[np.float64]

SEARCH_EDGE_M = 1.0
"""Edge of the columns by which points are sorted for searches, in metres: they lie about 0.8 m apart."""

COLUMN_M = 2.0
"""Edge of the vertical columns in which two places are compared, in metres."""

_STEEPEST_GROUND = np.cos(np.radians(70.0))
"""Ground with a steeper normal is a lone ring of a beam: a line, whose normal is a guess and looks at the sensor. Such
rings stand like boards around each spot a scan was taken from, and alignment would put board on board instead of
surface on surface (docs/decisions/0008).
"""

_FACING_ALIKE = 0.6  # smallest cosine between the normals of two points on one surface


@dataclass(frozen=True)
class OrientedPoints(Keeping):
    """Points (n, 3) in metres with unit normals (n, 3), float64, the first `standing_count` of them off the ground."""

    points: Array64
    normals: Array64
    standing_count: int

    @classmethod
    def of(cls, place: Place) -> OrientedPoints:
        """The stored surface of a place, in its level frame; kept with the place.

        Ground whose stored normal is steep gets one that looks up: see `_STEEPEST_GROUND`.
        """
        return place.kept(cls._copied)

    @classmethod
    def _copied(cls, place: Place) -> OrientedPoints:
        normals = place.normals.astype(np.float64)
        ground = normals[place.standing_count :]
        ground[np.abs(ground[:, 2]) < _STEEPEST_GROUND] = (0.0, 0.0, 1.0)
        return cls(place.points.astype(np.float64), normals, place.standing_count)

    @cached_property
    def tree(self) -> cKDTree:
        """For nearest neighbours among the points."""
        return cKDTree(self.points)

    def patches_by(self, edge_m: float) -> Patches:
        """For nearest neighbours among the points, by the kernels: in columns of `edge_m`."""
        return patches_of(self.points, self.normals, edge_m)

    @cached_property
    def patches(self) -> Patches:
        """For the nearest neighbour of a point, by the kernels: in columns of SEARCH_EDGE_M."""
        return self.patches_by(SEARCH_EDGE_M)

    @cached_property
    def seen(self) -> SeenColumns:
        """The columns of COLUMN_M in which any point lies, for the kernels."""
        return seen_columns(np.ascontiguousarray(self.points), COLUMN_M)

    @cached_property
    def standing(self) -> OrientedPoints:
        """The points off the ground."""
        return OrientedPoints(
            self.points[: self.standing_count], self.normals[: self.standing_count], self.standing_count
        )

    def thinned(self, share: int) -> OrientedPoints:
        """Every `share`-th point; the ground is as likely among them as before."""
        count = len(range(0, self.standing_count, share))
        return OrientedPoints(self.points[::share], self.normals[::share], count)

    def chosen(self, rows: NDArray[np.bool_]) -> OrientedPoints:
        """The points of which `rows` (n,) says so."""
        return OrientedPoints(self.points[rows], self.normals[rows], int(rows[: self.standing_count].sum()))

    def moved(self, T_new_old: se3.Matrix4) -> OrientedPoints:
        """The same surface in another frame."""
        points, normals = se3.apply(T_new_old, self.points), self.normals @ T_new_old[:3, :3].T
        return OrientedPoints(points, normals, self.standing_count)

    def shifted(self, offset_m: Array64) -> OrientedPoints:
        """The same surface moved by `offset_m` (3,) without a turn."""
        return replace(self, points=self.points + offset_m)


@dataclass(frozen=True)
class Contact:
    """Which points of one surface lie on another.

    touching (n,) says for each point whether it does; for the k that do, residuals (k,) are their signed distances in
    metres to the tangent plane of their counterparts, rows (k,) the rows of these counterparts.
    """

    touching: NDArray[np.bool_]
    residuals: Array64
    rows: NDArray[np.int32]


def contact(surface: OrientedPoints, other: OrientedPoints, config: VerificationConfig) -> Contact:
    """Where `surface` lies on `other`: near one of its points, near its tangent plane, facing alike. One frame."""
    rows, distances = touching_rows(
        np.ascontiguousarray(surface.points), np.ascontiguousarray(surface.normals), other.patches,
        *_contact_rules(config),
    )  # fmt: skip
    touching = rows >= 0
    return Contact(touching, distances[touching], other.patches.rows[rows[touching]])


@dataclass(frozen=True)
class ContactSums:
    """How much of a surface lies on another one, in a pose.

    standing: how many points off the ground stand in the columns that the other has seen; standing_touching: how many
    of these touch it, as in `contact`; touching: how many of all points do. squares: the sum of the squared distances
    (m^2) of the latter to the planes of their counterparts; information (6, 6): of the pose, from unit variances.
    """

    standing: int
    standing_touching: int
    touching: int
    squares: float
    information: Array64

    @property
    def share(self) -> float:
        """Of what stands in the common region, the share that touches."""
        return self.standing_touching / max(self.standing, 1)


def contact_in_poses(
    placed: Sequence[tuple[se3.Matrix4, OrientedPoints, OrientedPoints]], config: VerificationConfig
) -> list[ContactSums]:
    """For each T_other_surface, surface and other: what the surface has in common with the other where that puts it."""
    found = []
    for T_other_surface, surface, other in placed:
        (standing, standing_touching, touching), squares, information = contact_sums(
            np.ascontiguousarray(surface.points), np.ascontiguousarray(surface.normals), surface.standing_count,
            np.ascontiguousarray(T_other_surface), other.patches, *_contact_rules(config), other.seen.slots, COLUMN_M,
        )  # fmt: skip
        found.append(ContactSums(int(standing), int(standing_touching), int(touching), float(squares), information))
    return found


def shared_shares(
    surface: OrientedPoints, other: OrientedPoints, offsets_m: Array64, config: VerificationConfig
) -> list[float]:
    """For each of `offsets_m` (s, 3) by which `surface` is moved: the share of it that touches `other` then, of what
    stands in the columns that `other` has seen. One frame.
    """
    points, normals = np.ascontiguousarray(surface.points), np.ascontiguousarray(surface.normals)
    rules = *_contact_rules(config), other.seen.slots, COLUMN_M
    counts = shared_counts(points, normals, offsets_m, other.patches, *rules)
    return [float(touching) / max(int(seen), 1) for seen, touching in counts]


def _contact_rules(config: VerificationConfig) -> tuple[float, float, float, float]:
    """Edge, reach, distance of planes and cosine of normals, as the kernels of contact take them."""
    return SEARCH_EDGE_M, config.neighbour_distance, config.surface_distance, _FACING_ALIKE
