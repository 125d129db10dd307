"""Where the ground is: whether z points up."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.geometry.upright import TELLING_WALLS, UpAxis, contradicting_up
from revisit.core.geometry.voxel_keys import first_rows, voxel_keys
from revisit.core.sanity.finding import Finding
from revisit.core.sanity.numbers import MIN_SCENE_M
from revisit.core.scan import Scan

Array = NDArray[np.float64]
PlaneScores = Callable[[Array, Array, Array, float, float], Array]

MAX_TILT_COSINE = 0.94

_AT_ONCE = 16
"""Planes whose distances to all points fit into a processor's cache."""

SAME_LEAN_RAD, ROUGH_PLANE_RAD = float(np.radians(3.0)), float(np.radians(5.0))
"""By how much two scans may differ in their lean; and how far off the plane around a sensor is, which is a guess."""


@dataclass(frozen=True)
class GroundPlane:
    """The plane that the sensor stands over.

    normal (3,) points to the sensor's side; `height_m` is the sensor's distance; `upright` tells whether the plane is
    level within 20 degrees, or whether there is another one that is, with at least half as many points.
    """

    normal: Array
    height_m: float
    upright: bool

    @property
    def tilt_rad(self) -> float:
        """How far the plane is from level."""
        return float(np.arccos(np.clip(self.normal[2], -1.0, 1.0)))


def scores_of_planes(normals: Array, offsets: Array, points: Array, near: float, below: float) -> Array:
    """See `core.kernels.plane_votes`, the compiled form of this, which the SDK does not have."""
    scores = np.empty(len(normals))
    for start in range(0, len(normals), _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        above = normals[some] @ points.T + offsets[some, None]
        scores[some] = (np.abs(above) < near).mean(axis=1) - 2.0 * (above < -below).mean(axis=1)
    return scores


def ground_plane(
    points: NDArray[np.floating], seed: int = 0, scores_of: PlaneScores = scores_of_planes
) -> GroundPlane | None:
    """The plane around the sensor, from points (n, 3) whose origin is the sensor's, z as they have it.

    None where no plane surrounds the sensor, as with one that looks ahead only: a wall beside it is no ground.
    """
    thinned, scale = thinned_cloud(points)
    if len(thinned) < 50:
        return None
    corners = thinned[np.random.default_rng(seed).integers(0, len(thinned), (400, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals, corners = normals[lengths > 1e-9] / lengths[lengths > 1e-9, None], corners[lengths > 1e-9]
    offsets = -np.einsum("ij,ij->i", normals, corners[:, 0])
    sign = np.where(offsets < 0.0, -1.0, 1.0)
    normals, offsets = normals * sign[:, None], offsets * sign
    scores = scores_of(normals, offsets, np.ascontiguousarray(thinned), 0.1 * scale, 0.3 * scale)
    best = int(scores.argmax())
    inliers = thinned[np.abs(thinned @ normals[best] + offsets[best]) < 0.1 * scale]
    if scores[best] < 0.15 or not _surrounds(inliers, normals[best], offsets[best]):
        return None
    level = scores[normals[:, 2] > MAX_TILT_COSINE]
    # a ceiling is seen better than the floor under the sensor, which then is there as well
    share = 0.5 if normals[best, 2] > -MAX_TILT_COSINE else 0.15
    upright = len(level) > 0 and float(level.max()) >= share * scores[best]
    return GroundPlane(normals[best], float(offsets[best]), upright)


def place_flags(
    points: NDArray[np.floating], scene_scale: float = 1.0, scores_of: PlaneScores = scores_of_planes
) -> tuple[str, ...]:
    """Flags of a submap: "ground_tilted", "scene_too_small".

    `points` (n, 3) in its level frame, whose lengths are divided by `scene_scale`. A scene that is too large does not
    come so far: its points lie beyond the sensor's range.
    """
    sample = np.ascontiguousarray(sample_of(points))  # a sample of it is itself
    plane = ground_plane(sample, scores_of=scores_of)
    size_m = scene_scale * float(np.sqrt(np.percentile(np.einsum("ij,ij->i", sample, sample), 95.0)))
    tilted = plane is not None and not plane.upright
    return ("ground_tilted",) * tilted + ("scene_too_small",) * (size_m < MIN_SCENE_M)


def ground_lean(points: NDArray[np.floating], scores_of: PlaneScores = scores_of_planes) -> UpAxis | None:
    """The vertical of a level submap by its points (n, 3), where its surfaces contradict z; None where z may point up.

    A plane around the sensor must agree: roofs and panels in rows are many, but no ground. Where no plane surrounds
    the sensor, walls must: a hillside beside a level way leans, and is no ground either.
    """
    sample = np.ascontiguousarray(sample_of(points))
    up = contradicting_up(sample)
    if up is None:
        return None
    plane = ground_plane(sample, scores_of=scores_of)
    agrees = up.walls >= TELLING_WALLS if plane is None else float(up.up @ plane.normal) > np.cos(ROUGH_PLANE_RAD)
    return up if agrees else None


def thinned_cloud(points: NDArray[np.floating]) -> tuple[Array, float]:
    """At most 3,000 of the nearer points, one a voxel, and the scene's scale compared with a street's."""
    points = sample_of(points)
    # returns that did not come back are zeros in some drivers' data
    x, y, z = points.T
    points = points.take(np.flatnonzero((x != 0.0) | (y != 0.0) | (z != 0.0)), axis=0)
    ranges = np.sqrt(np.einsum("ij,ij->i", points, points))
    if len(points) == 0:
        return np.empty((0, 3)), 1.0
    middle = np.median(ranges)
    scale = float(np.clip(middle / 10.0, 0.02, 1_000.0))
    near = points.take(np.flatnonzero(ranges < 3.0 * middle), axis=0).astype(np.float64)
    thinned = near[first_rows(voxel_keys(np.floor(near / (0.4 * scale)).astype(np.int64)))]
    return thinned[:: max(1, len(thinned) // 3_000)], scale


def _surrounds(inliers: Array, normal: Array, offset: float) -> bool:
    """Whether points of a plane lie all around the foot of the sensor, in 9 of 12 directions."""
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    along = np.cross(normal, across)
    from_foot = inliers + offset * normal
    sectors = np.floor((np.arctan2(from_foot @ along, from_foot @ across) + np.pi) * 6.0 / np.pi).astype(int) % 12
    return bool((np.bincount(sectors, minlength=12) >= 0.02 * len(inliers)).sum() >= 9)


def check_gravity(scans: Sequence[Scan], scores_of: PlaneScores = scores_of_planes) -> list[Finding]:
    """Whether the ground lies below the sensors, in the frame of the odometry."""
    planes = [_plane_seen(scan, scan.T_odom_sensor[:3, :3], scores_of) for scan in scans]
    known = [(scan, plane) for scan, plane in zip(scans, planes, strict=True) if plane is not None]
    tilted = [plane for _, plane in known if not plane.upright]
    if len(known) < max(2, len(scans) // 3) or len(tilted) < 0.7 * len(known):
        return _leaning(scans, scores_of)
    heights = np.median([plane.height_m for plane in tilted])
    tilts = [np.degrees(plane.tilt_rad) for plane in tilted]
    measured = f"the ground, {heights:.2g} m away, is tilted by {np.median(tilts):.0f} degrees"
    reread = [_plane_seen(scan, read_as_wxyz(scan.T_odom_sensor), scores_of) for scan, _ in known]
    if np.mean([plane is not None and plane.upright for plane in reread]) > 0.7:
        cause, advice = "the quaternions are in the order w, x, y, z", "give them as x, y, z, w"
        return [Finding("quaternion_order", measured, cause, advice)]
    return [Finding("ground_tilted", measured, *_why_tilted(np.median([plane.normal for plane in tilted], axis=0)))]


def _leaning(scans: Sequence[Scan], scores_of: PlaneScores) -> list[Finding]:
    """Whether the surfaces of the first and the last scan have one vertical, and that is not z of the odometry."""
    first: UpAxis | None = None
    for scan in (scans[0], scans[-1]) if len(scans) > 1 else ():
        up = ground_lean(sample_of(scan.points) @ scan.T_odom_sensor[:3, :3].T, scores_of)
        if up is None or (first and first.up @ up.up < np.cos(SAME_LEAN_RAD)):
            return []
        first = up
    if first is None:
        return []
    measured = f"ground and walls are tilted by {np.degrees(first.tilt_rad):.0f} degrees"
    cause = "z of the odometry's frame does not point up: a sensor mounted askew, or an odometry that began on a slope"
    advice = (
        "give T_odom_sensor with z up: submaps are levelled by ground and walls, but a map leans as its oldest session"
    )
    return [Finding("ground_tilted", measured, cause, advice)]


def _why_tilted(normal: Array) -> tuple[str, str]:
    """The likely cause of a ground with such a normal (3,), and the advice."""
    if normal[2] < -MAX_TILT_COSINE:
        return "z points down (NED, or a sensor that hangs upside down)", "give poses in a frame whose z axis points up"
    if abs(normal[1]) > 0.9:
        return "camera axes (y down, z ahead)", "give poses of the LiDAR in a frame whose z axis points up"
    return "the poses are not those of the LiDAR, or their frame has no z up", "give T_odom_sensor with z up"


def read_as_wxyz(transform: se3.Matrix4) -> Array:
    """The rotation (3, 3) if the four numbers that were read as x, y, z, w are w, x, y, z."""
    w, x, y, z = se3.to_quaternion(transform)
    return np.asarray(se3.from_quaternion((x, y, z, w), np.zeros(3))[:3, :3])


def _plane_seen(scan: Scan, rotation: Array, scores_of: PlaneScores) -> GroundPlane | None:
    """The ground of a scan turned by `rotation` (3, 3)."""
    return ground_plane(sample_of(scan.points) @ rotation.T, scores_of=scores_of)


def sample_of(points: NDArray[np.floating]) -> NDArray[np.floating]:
    """Every so many-th point: 30,000 to 60,000, or all of fewer."""
    return points[:: max(1, len(points) // 30_000)]
