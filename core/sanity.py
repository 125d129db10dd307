"""Whether clouds and poses can be what they claim: metres, upright, right-handed, in nanoseconds.

Nothing here refuses; a `Finding` says what was measured, what most likely causes it, and what to do. The thresholds are
set so that real drives and rooms have no findings (docs/how-to/check-a-recording.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from revisit.core.geometry import se3
from revisit.core.geometry.voxel_keys import voxel_keys
from revisit.core.scan import MAX_SCENE_M, Scan

Array = NDArray[np.float64]
Poses = NDArray[np.float64]
Stamps = NDArray[np.int64]

MIN_SCENE_M = 1.0
MAX_SPEED_M_PER_S = 70.0
MIN_PERIOD_NS = 2_000_000
MIN_POINTS_A_SCAN = 1_000
MAX_NON_FINITE = 0.4
MAX_TILT_COSINE = 0.94
AGREEMENT_MARGIN = 0.15


@dataclass(frozen=True)
class Finding:
    """Something that is unlikely to be meant: a stable code, what was measured, the likely cause, and what to do."""

    code: str
    measured: str
    cause: str
    advice: str


@dataclass(frozen=True)
class GroundPlane:
    """The plane that the sensor stands over.

    normal (3,) points to the sensor's side; `height_m` is the sensor's distance; `upright` tells whether the plane is
    level within 20 degrees, or whether there is another one that is, with at least half as many points.
    """

    normal: Array
    height_m: float
    upright: bool


@dataclass(frozen=True)
class ScenePair:
    """Two scans that saw the same place from different poses."""

    first: Scan
    second: Scan


def check_units(sizes_m: Sequence[float]) -> list[Finding]:
    """Whether scenes of such sizes (`scene_size`) are in metres."""
    if not sizes_m:
        return []
    size = float(np.median(sizes_m))
    measured = f"95 % of the points lie within {size:.3g} m"
    if size > MAX_SCENE_M:
        unit, factor = ("millimetres", 0.001) if size > 8_000.0 else ("centimetres", 0.01)
        return [Finding("scene_too_large", measured, f"the points are in {unit}", f"multiply them by {factor}")]
    if size < MIN_SCENE_M:
        return [Finding("scene_too_small", measured, "the points are scaled, or in kilometres", "give metres")]
    return []


def check_times(stamps_ns: Stamps) -> list[Finding]:
    """Whether the times (n,) rise, and by as much as a LiDAR takes for a scan."""
    if len(stamps_ns) < 3:
        return []
    steps = np.diff(stamps_ns)
    period = float(np.median(steps))
    found = []
    if 0 <= period < MIN_PERIOD_NS:
        unit = "seconds" if period < 20 else "milliseconds" if period < 20_000 else "microseconds"
        cause, advice = f"the times are in {unit}", "give nanoseconds (stamp_ns)"
        found.append(Finding("time_unit", f"scans are {period:g} ns apart", cause, advice))
    elif (steps <= 0).any():
        measured = f"{int((steps <= 0).sum())} of {len(steps)} scans are no later than the one before"
        cause = "the clock was set, or two recordings are joined"
        found.append(Finding("time_goes_back", measured, cause, "one session for each run of the clock"))
    return found


def check_motion(poses: Poses, stamps_ns: Stamps) -> list[Finding]:
    """Whether poses (n, 4, 4) move as a robot does: no jumps, and no speed above 250 km/h."""
    if len(poses) < 3:
        return []
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    typical = float(np.median(steps))
    jumps = np.flatnonzero(steps > max(15.0, 20.0 * typical))
    found = []
    if len(jumps):
        where = f"the largest {steps.max():.0f} m behind scan {steps.argmax()}"
        measured = f"{len(jumps)} of {len(steps)} steps are jumps, {where}"
        cause = "GNSS fixes, a map frame that is corrected, or two recordings in one"
        found.append(Finding("pose_jump", measured, cause, "give smooth odometry, or one session for each part"))
    seconds = float(np.median(np.diff(stamps_ns))) / 1e9
    if seconds >= MIN_PERIOD_NS / 1e9 and typical / seconds > MAX_SPEED_M_PER_S:
        measured = f"the sensor moves at {typical / seconds:.0f} m/s"
        found.append(Finding("too_fast", measured, "the poses are no metres, or the times no nanoseconds", "give both"))
    return found


def check_points(scans: Sequence[Scan]) -> list[Finding]:
    """Whether the scans have enough points, few of them missing, and rows that are read as they were written."""
    found = []
    counts = [len(scan.points) for scan in scans]
    missing = [scan.report.dropped_nonfinite / (scan.report.dropped_nonfinite + len(scan.points)) for scan in scans]
    if np.median(counts) < MIN_POINTS_A_SCAN:
        measured = f"{int(np.median(counts))} points a scan"
        cause = "packets of a sweep instead of sweeps, or thinned clouds"
        found.append(Finding("sparse", measured, cause, "send whole sweeps with all their points"))
    if np.median(missing) > MAX_NON_FINITE:
        measured = f"{100 * np.median(missing):.0f} % of the points are NaN or infinite"
        cause = "an organised cloud of an open place, or a damaged field"
        found.append(Finding("non_finite", measured, cause, "leave them out; see whether the fields are right"))
    at_origin = np.median([(np.abs(scan.points) < 0.01).all(axis=1).mean() for scan in scans])
    if at_origin > 0.3:
        measured = f"{100 * at_origin:.0f} % of the points are at the sensor's origin"
        found.append(Finding("zeros", measured, "returns that did not come back are stored as zeros", "leave them out"))
    columns = [_columns(scan) for scan in scans]
    if scans and columns.count(4) < len(columns) / 2:
        likely = 3 if columns.count(3) >= columns.count(5) else 5
        measured = f"every {likely}rd row differs from the others" if likely == 3 else "every 5th row differs"
        cause = f"rows of {likely} numbers are read as rows of 4"
        found.append(Finding("columns", measured, cause, "write float32 x, y, z, reflectance, or .npy, .ply or .pcd"))
    return found


def _columns(scan: Scan) -> int:
    """How many numbers a row of the source had: rows of 3 or 5 that are read as 4 change their meaning periodically."""
    for period in (3, 5):
        rows = [scan.points[start::period] for start in range(period)]
        there = [part[(part != 0.0).any(axis=1)] for part in rows]
        if min(len(part) for part in there) == 0:
            continue
        spread = np.array([np.median(np.abs(part), axis=0) for part in there])
        if (spread.max(axis=0) > 3.0 * np.maximum(spread.min(axis=0), 1e-6)).sum() >= 2:
            return period
    return 4


def ground_plane(points: NDArray[np.floating], seed: int = 0) -> GroundPlane | None:
    """The plane around the sensor, from points (n, 3) whose origin is the sensor's, z as they have it.

    None where no plane surrounds the sensor, as with one that looks ahead only: a wall beside it is no ground.
    """
    thinned, scale = _thinned(points)
    if len(thinned) < 50:
        return None
    corners = thinned[np.random.default_rng(seed).integers(0, len(thinned), (400, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals, corners = normals[lengths > 1e-9] / lengths[lengths > 1e-9, None], corners[lengths > 1e-9]
    offsets = -np.einsum("ij,ij->i", normals, corners[:, 0])
    sign = np.where(offsets < 0.0, -1.0, 1.0)
    normals, offsets = normals * sign[:, None], offsets * sign
    above = normals @ thinned.T + offsets[:, None]
    scores = (np.abs(above) < 0.1 * scale).mean(axis=1) - 2.0 * (above < -0.3 * scale).mean(axis=1)
    best = int(scores.argmax())
    if scores[best] < 0.15 or not _surrounds(thinned[np.abs(above[best]) < 0.1 * scale], normals[best], offsets[best]):
        return None
    level = scores[normals[:, 2] > MAX_TILT_COSINE]
    upright = len(level) > 0 and float(level.max()) >= 0.5 * scores[best]
    return GroundPlane(normals[best], float(offsets[best]), upright)


def place_flags(points: NDArray[np.floating], scene_scale: float = 1.0) -> tuple[str, ...]:
    """What is suspicious about a submap: "ground_tilted", "scene_too_small".

    `points` (n, 3) in its level frame, whose lengths are divided by `scene_scale`. A scene that is too large does not
    come so far: its points lie beyond the sensor's range.
    """
    plane = ground_plane(points)
    size_m = scene_scale * float(np.percentile(np.linalg.norm(points[:: max(1, len(points) // 30_000)], axis=1), 95.0))
    tilted = plane is not None and not plane.upright
    return ("ground_tilted",) * tilted + ("scene_too_small",) * (size_m < MIN_SCENE_M)


def _thinned(points: NDArray[np.floating]) -> tuple[Array, float]:
    """At most 3,000 of the nearer points, one a voxel, and the scene's scale compared with a street's."""
    points = points[:: max(1, len(points) // 30_000)]
    points = points[(points != 0.0).any(axis=1)]  # returns that did not come back, as some drivers store them
    ranges = np.linalg.norm(points, axis=1)
    if len(points) == 0:
        return np.empty((0, 3)), 1.0
    scale = float(np.clip(np.median(ranges) / 10.0, 0.02, 1_000.0))
    near = points[ranges < 3.0 * np.median(ranges)].astype(np.float64)
    _, first = np.unique(voxel_keys(np.floor(near / (0.4 * scale)).astype(np.int64)), return_index=True)
    thinned = near[first]
    return thinned[:: max(1, len(thinned) // 3_000)], scale


def _surrounds(inliers: Array, normal: Array, offset: float) -> bool:
    """Whether points of a plane lie all around the foot of the sensor, in 9 of 12 directions."""
    across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    across /= np.linalg.norm(across)
    along = np.cross(normal, across)
    from_foot = inliers + offset * normal
    sectors = np.floor((np.arctan2(from_foot @ along, from_foot @ across) + np.pi) * 6.0 / np.pi).astype(int) % 12
    return bool((np.bincount(sectors, minlength=12) >= 0.02 * len(inliers)).sum() >= 9)


def check_gravity(scans: Sequence[Scan]) -> list[Finding]:
    """Whether the ground lies below the sensors, in the frame of the odometry."""
    turned = [(scan, scan.T_odom_sensor[:3, :3]) for scan in scans]
    planes = [ground_plane(scan.points @ rotation.T) for scan, rotation in turned]
    known = [(scan, plane) for scan, plane in zip(scans, planes, strict=True) if plane is not None]
    tilted = [plane for _, plane in known if not plane.upright]
    if len(known) < max(2, len(scans) // 3) or len(tilted) < 0.7 * len(known):
        return []
    heights = np.median([plane.height_m for plane in tilted])
    tilts = [np.degrees(np.arccos(np.clip(plane.normal[2], -1.0, 1.0))) for plane in tilted]
    measured = f"the ground, {heights:.2g} m away, is tilted by {np.median(tilts):.0f} degrees"
    if _upright_share([scan for scan, _ in known], _wxyz) > 0.7:
        cause, advice = "the quaternions are in the order w, x, y, z", "give them as x, y, z, w"
        return [Finding("quaternion_order", measured, cause, advice)]
    return [Finding("ground_tilted", measured, *_why_tilted(np.median([plane.normal for plane in tilted], axis=0)))]


def _why_tilted(normal: Array) -> tuple[str, str]:
    """The likely cause of a ground with such a normal (3,), and what to do."""
    if normal[2] < -MAX_TILT_COSINE:
        return "z points down (NED, or a sensor that hangs upside down)", "give poses in a frame whose z axis points up"
    if abs(normal[1]) > 0.9:
        return "camera axes (y down, z ahead)", "give poses of the LiDAR in a frame whose z axis points up"
    return "the poses are not those of the LiDAR, or their frame has no z up", "give T_odom_sensor with z up"


def _wxyz(transform: se3.Matrix4) -> Array:
    """The rotation (3, 3) if the four numbers that were read as x, y, z, w are w, x, y, z."""
    w, x, y, z = se3.to_quaternion(transform)
    return np.asarray(se3.from_quaternion((x, y, z, w), np.zeros(3))[:3, :3])


def _upright_share(scans: Sequence[Scan], rotation: Callable[[se3.Matrix4], Array]) -> float:
    planes = [ground_plane(scan.points @ rotation(scan.T_odom_sensor).T) for scan in scans]
    return float(np.mean([plane is not None and plane.upright for plane in planes]))


def agreement(pair: ScenePair, T_first_second: se3.Matrix4) -> float:
    """The share of the second scan's points that lie near a point of the first one, once moved by the transform."""
    first = pair.first.points[:: max(1, len(pair.first.points) // 30_000)]
    second, scale = _thinned(pair.second.points)
    if len(second) == 0:
        return 0.0
    distances, _ = cKDTree(first).query(se3.apply(T_first_second, second), distance_upper_bound=0.2 * scale)
    return float(np.isfinite(distances).mean())


def check_agreement(pairs: Sequence[ScenePair]) -> list[Finding]:
    """Whether scans lie on each other once moved by their poses, or would so if the poses meant something else."""
    if not pairs:
        return []
    poses = [(pair.first.T_odom_sensor, pair.second.T_odom_sensor) for pair in pairs]
    as_given = _mean_agreement(pairs, [se3.inverse(one) @ other for one, other in poses])
    others = {name: _mean_agreement(pairs, [step(*both) for both in poses]) for name, step in _STEPS.items()}
    best = max(others, key=lambda name: others[name])
    if others[best] < as_given + AGREEMENT_MARGIN:
        return []
    measured = f"{100 * as_given:.0f} % of the points meet the scan before; {100 * others[best]:.0f} % if {best}"
    return [Finding(_CODES[best], measured, best, _ADVICE[best])]


def _mean_agreement(pairs: Sequence[ScenePair], steps: Sequence[se3.Matrix4]) -> float:
    return float(np.mean([agreement(pair, step) for pair, step in zip(pairs, steps, strict=True)]))


Step = Callable[[se3.Matrix4, se3.Matrix4], se3.Matrix4]
"""T_first_second of two poses, if these mean something else than T_odom_sensor."""


def _seen_through(T_given_meant: se3.Matrix4) -> Step:
    """The poses follow axes of another orientation or handedness than the clouds have."""
    T_meant_given = np.linalg.inv(T_given_meant)
    return lambda one, other: np.asarray(T_meant_given @ se3.inverse(one) @ other @ T_given_meant)


def _reordered(one: se3.Matrix4, other: se3.Matrix4) -> se3.Matrix4:
    first, second = (se3.from_rotation_translation(_wxyz(pose), pose[:3, 3]) for pose in (one, other))
    return se3.inverse(first) @ second


_CAMERA_LIDAR = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
_REGISTERED = "the clouds are already in the frame of the odometry"
_INVERTED = "the poses are inverted"
_MIRRORED = "the y axis is mirrored"
_MIRRORED_X = "the x axis is mirrored"
_CAMERA = "the poses are those of a camera (x right, y down, z ahead)"
_REORDERED = "the quaternions are in the order w, x, y, z"
_STEPS: dict[str, Step] = {
    _REGISTERED: lambda one, other: np.eye(4),
    _INVERTED: lambda one, other: one @ se3.inverse(other),
    _MIRRORED: _seen_through(np.diag([1.0, -1, 1, 1])),
    _MIRRORED_X: _seen_through(np.diag([-1.0, 1, 1, 1])),
    _CAMERA: _seen_through(_CAMERA_LIDAR),
    _REORDERED: _reordered,
}
_CODES = {
    _REGISTERED: "registered", _INVERTED: "poses_inverted", _MIRRORED: "mirrored", _MIRRORED_X: "mirrored",
    _CAMERA: "camera_axes", _REORDERED: "quaternion_order",
}  # fmt: skip
_ADVICE = {
    _REGISTERED: "give clouds in the sensor's frame",
    _INVERTED: "give T_odom_sensor, which takes points of the sensor to the odometry's frame",
    _MIRRORED: "give right-handed axes: x ahead, y left, z up",
    _MIRRORED_X: "give right-handed axes: x ahead, y left, z up",
    _CAMERA: "give poses of the LiDAR (KITTI: with calib.txt)",
    _REORDERED: "give them as x, y, z, w",
}
