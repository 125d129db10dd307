"""Findings of checks."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """An unlikely value: a stable code, the measurement, the likely cause and the advice."""

    code: str
    measured: str
    cause: str
    advice: str


LIKELY_CAUSES = {
    "scene_too_large": ("the points are in centimetres or millimetres", "give metres"),
    "scene_too_small": ("the points are scaled, or in kilometres", "give metres"),
    "ground_tilted": (
        "z of the odometry does not point up (askew, NED, camera axes), or the poses are not those of the LiDAR",
        "give T_odom_sensor with z up; submaps that lean by 10 to 40 degrees are levelled, but a map of them leans",
    ),
    "quaternion_order": ("the quaternions are in the order w, x, y, z", "give them as x, y, z, w"),
    "registered": (
        "the clouds are already in the frame of the odometry, or most returns go with the sensor (its vehicle)",
        "give clouds in the sensor's frame, without returns from the vehicle itself",
    ),
    "poses_inverted": (
        "the poses are inverted",
        "give T_odom_sensor, which takes points of the sensor to odom",
    ),
    "mirrored": ("an axis of the clouds is mirrored", "give right-handed axes: x ahead, y left, z up"),
    "camera_axes": ("the poses are those of a camera (x right, y down, z ahead)", "give poses of the LiDAR"),
    "time_unit": ("the times are in seconds, milliseconds or microseconds", "give nanoseconds (stamp_ns)"),
    "time_goes_back": ("the clock was set, or two recordings are joined", "one session for each run of the clock"),
    "pose_jump": (
        "GNSS fixes, a map frame that is corrected, or an odometry that began anew",
        "give smooth odometry, and a session of its own for each run of it",
    ),
    "too_fast": ("the poses are no metres, or the times no nanoseconds", "give both"),
    "sparse": ("packets of a sweep instead of sweeps, or thinned clouds", "send whole sweeps with all their points"),
    "zeros": ("returns that did not come back are stored as zeros", "leave them out"),
    "columns": (
        "rows of 3 or 5 numbers are read as rows of 4",
        "write float32 x, y, z, reflectance, or .npy, .ply, .pcd",
    ),
    "non_finite": ("an organised cloud of an open place, or a damaged field", "leave NaN and infinity out"),
    "odometry_bends": (
        (
            "the odometry turns steadily beside the truth, by more than 0.05 degrees a metre; in curves alone: the "
            "sensor's mount is not as the poses have it"
        ),
        "calibrate its gyroscope or wheels, or the mount; submaps are straightened before they are described",
    ),
    "degenerate_plane": ("all points lie on one plane", "expect no loops from such a place"),
    "empty_cloud": ("most points lie beyond the sensor's range: centimetres or millimetres", "give metres"),
}
"""Code -> likely cause and advice, where the measurement is not at hand any more."""

LEAST_SHARES = {"odometry_bends": 0.25}
"""Code -> share of the submaps of a session from which on it is a finding: of good drives up to 13 % bend a little, of
such that turn by 0.1 degrees a metre 76 %.
"""
