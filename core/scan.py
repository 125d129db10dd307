"""Scan: one validated sweep of a LiDAR and the odometry pose it was taken from."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import BadField, DegenerateCloud, EmptyCloud, NonFinitePoints, OutOfRange
from revisit.core.geometry import se3
from revisit.core.point_columns import Columns, usable

Points = NDArray[np.float32]

MIN_POINTS = 100
MAX_COORDINATE_M = 10_000.0
MAX_DROPPED_SHARE = 0.9

_PLANE_ROWS = 6_000
_PIECE = 60  # a whole number of times 2, 3, 4 and 5
# No LiDAR sees most of a scene farther away: such a cloud is not in metres.
MAX_SCENE_M = 400.0


@dataclass(frozen=True)
class CloudReport:
    """Notes of the validation of a cloud."""

    dropped_nonfinite: int
    degenerate_plane: bool


@dataclass(frozen=True)
class Scan:
    """One sweep. `points` (n, 3) float32 in the sensor frame, metres; `stamp_ns` in the robot's clock.

    `columns` of the returns (`core.point_columns`) are those that are known.
    """

    points: Points
    T_odom_sensor: se3.Matrix4
    stamp_ns: int
    report: CloudReport
    columns: Columns = field(default_factory=dict)

    @classmethod
    def validated(
        cls,
        points: NDArray[np.floating],
        T_odom_sensor: NDArray[np.float64],
        stamp_ns: int,
        columns: Columns | None = None,
    ) -> Scan:
        """A scan of finite, non-degenerate points. Raises as `validate_cloud` and `posed` do.

        A column that cannot be used, or that is 0 everywhere, is left out: it costs no scan.
        """
        scan = cls.posed(*validate_cloud(points), T_odom_sensor, stamp_ns)
        return replace(scan, columns=usable(columns, points)) if columns else scan

    @classmethod
    def posed(cls, points: Points, report: CloudReport, T_odom_sensor: NDArray[np.float64], stamp_ns: int) -> Scan:
        """A scan of a validated cloud (`validate_cloud`). Raises BadField, and as `se3.validated` does."""
        if stamp_ns < 0 or stamp_ns >= 2**63:
            raise BadField("the time stamp must be in [0, 2^63) nanoseconds", field="stamp_ns")
        return cls(points, se3.validated(T_odom_sensor), stamp_ns, report)


def scene_size(scan: Scan) -> float:
    """The range below which 95 % of the points lie, metres."""
    return float(np.percentile(np.linalg.norm(scan.points, axis=1), 95.0))


def validate_cloud(points: NDArray[np.floating]) -> tuple[Points, CloudReport]:
    """The finite points of a cloud as contiguous (n, 3) float32, with its notes.

    Raises BadField for another shape, EmptyCloud below 100 points, NonFinitePoints where more than 90 % are NaN or
    infinite, OutOfRange beyond 10 km, DegenerateCloud where the points are identical or on one line.
    """
    if points.ndim != 2 or points.shape[1] != 3:
        raise BadField(f"points must be (n, 3), got {points.shape}", field="points")
    if len(points) < MIN_POINTS:
        raise EmptyCloud(f"a cloud needs at least {MIN_POINTS} points, got {len(points)}", field="points")
    kept = _finite(points)
    dropped = len(points) - len(kept)
    if dropped > MAX_DROPPED_SHARE * len(points):
        raise NonFinitePoints(f"{dropped} of {len(points)} points are NaN or infinite", field="points")
    if len(kept) < MIN_POINTS:
        raise EmptyCloud(f"a cloud needs at least {MIN_POINTS} finite points, got {len(kept)}", field="points")
    if max(float(kept.max()), -float(kept.min())) > MAX_COORDINATE_M:
        raise OutOfRange(field="points")
    cloud = np.ascontiguousarray(kept, dtype=np.float32)
    return cloud, CloudReport(dropped, is_plane(cloud))


def _finite(points: NDArray[np.floating]) -> NDArray[np.floating]:
    """The points without NaN and infinity."""
    finite = np.isfinite(points)
    return points.copy() if finite.all() else points[finite.all(axis=1)]


def is_plane(cloud: Points) -> bool:
    """Whether the cloud is coplanar; raises DegenerateCloud when it has less than two dimensions."""
    sample = spread_pieces(cloud, _PLANE_ROWS).astype(np.float64)
    centred = sample - sample.mean(axis=0)
    covariance = centred.T @ centred / (len(centred) - 1)
    spread = np.sqrt(np.clip(np.linalg.eigvalsh(covariance), 0.0, None))
    if spread[1] < 1e-3 or spread[1] < 1e-5 * spread[2]:
        raise DegenerateCloud(field="points")
    return bool(spread[0] < 0.02 and spread[0] < 0.01 * spread[2])


def spread_pieces(points: NDArray[np.floating], most: int) -> NDArray[np.floating]:
    """At most about `most` of the points (n, 3): pieces of 60 rows as they follow each other, evenly spread.

    Every so many-th row would see one kind of row only where kinds alternate: each second one zero, a beam of 64.
    """
    count = len(points) // _PIECE
    if count <= 1:
        return points
    pieces = points[: count * _PIECE].reshape(count, _PIECE, 3)
    return pieces[:: -(-count * _PIECE // most)].reshape(-1, 3)
