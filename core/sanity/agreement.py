"""Whether scans lie on each other once moved by their poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from revisit.core.geometry import se3
from revisit.core.sanity.finding import LIKELY_CAUSES, Finding
from revisit.core.sanity.ground import ground_plane, read_as_wxyz, sample_of, thinned_cloud
from revisit.core.scan import Scan

AGREEMENT_MARGIN = 0.15


@dataclass(frozen=True)
class ScenePair:
    """Two scans that saw the same place from different poses."""

    first: Scan
    second: Scan


class _Comparison:
    """A pair, prepared to be laid on each other in several ways."""

    def __init__(self, pair: ScenePair) -> None:
        self.poses = pair.first.T_odom_sensor, pair.second.T_odom_sensor
        self._first = cKDTree(sample_of(pair.first.points))
        self._second, self._scale = thinned_cloud(pair.second.points)

    def without_ground(self) -> _Comparison:
        """The same, without the points of the second scan that lie on the plane around its sensor."""
        plane, standing = ground_plane(self._second), copy(self)
        if plane is not None:
            heights = self._second @ plane.normal + plane.height_m
            standing._second = self._second[np.abs(heights) > 0.3 * self._scale]
        return standing

    def agreement(self, T_first_second: se3.Matrix4) -> float:
        """The share of the second scan's points that lie near a point of the first one, once moved so."""
        if len(self._second) == 0:
            return 0.0
        moved = se3.apply(T_first_second, self._second)
        distances, _ = self._first.query(moved, distance_upper_bound=0.2 * self._scale)
        return float(np.isfinite(distances).mean())


def share_met(pair: ScenePair) -> float:
    """The share, 0 to 1, of the second scan's points that lie near one of the first, once moved by the poses."""
    compared = _Comparison(pair)
    one, other = compared.poses
    return compared.agreement(se3.inverse(one) @ other)


def check_agreement(pairs: Sequence[ScenePair]) -> list[Finding]:
    """Whether scans lie on each other once moved by their poses, or would so if the poses meant something else.

    What stands on the ground must say so, too: the rings that few beams draw on a level ground go with the sensor.
    """
    if not pairs:
        return []
    compared = [_Comparison(pair) for pair in pairs]
    return _disagreement(compared) and _disagreement([pair.without_ground() for pair in compared])


def _disagreement(compared: Sequence[_Comparison]) -> list[Finding]:
    as_given = _mean_agreement(compared, lambda one, other: se3.inverse(one) @ other)
    if as_given + AGREEMENT_MARGIN > 1.0:  # nothing agrees better by so much
        return []
    others = {name: _mean_agreement(compared, step) for name, step in _STEPS.items()}
    best = max(others, key=lambda name: others[name])
    if others[best] < as_given + AGREEMENT_MARGIN:
        return []
    measured = f"{100 * as_given:.0f} % of the points meet the scan before; {100 * others[best]:.0f} % if {best}"
    return [
        Finding(_CODES[best], measured, LIKELY_CAUSES["registered"][0] if best == _REGISTERED else best, _ADVICE[best])
    ]


Step = Callable[[se3.Matrix4, se3.Matrix4], se3.Matrix4]
"""T_first_second of two poses, if these mean something else than T_odom_sensor."""


def _mean_agreement(compared: Sequence[_Comparison], step: Step) -> float:
    return float(np.mean([pair.agreement(step(*pair.poses)) for pair in compared]))


def _seen_through(T_given_meant: se3.Matrix4) -> Step:
    """The poses follow axes of another orientation or handedness than the clouds have."""
    T_meant_given = np.linalg.inv(T_given_meant)
    return lambda one, other: np.asarray(T_meant_given @ se3.inverse(one) @ other @ T_given_meant)


def _reordered(one: se3.Matrix4, other: se3.Matrix4) -> se3.Matrix4:
    first, second = (se3.from_rotation_translation(read_as_wxyz(pose), pose[:3, 3]) for pose in (one, other))
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
    _REGISTERED: LIKELY_CAUSES["registered"][1],
    _INVERTED: "give T_odom_sensor, which takes points of the sensor to the odometry's frame",
    _MIRRORED: "give right-handed axes: x ahead, y left, z up",
    _MIRRORED_X: "give right-handed axes: x ahead, y left, z up",
    _CAMERA: "give poses of the LiDAR (KITTI: with calib.txt)",
    _REORDERED: "give them as x, y, z, w",
}
