"""The scans that become one submap, looked at together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from revisit.core.geometry import se3
from revisit.core.sanity.agreement import ScenePair, check_agreement
from revisit.core.sanity.finding import Finding
from revisit.core.sanity.ground import PlaneScores, check_gravity, scores_of_planes
from revisit.core.sanity.numbers import check_motion, check_points, check_times, check_units
from revisit.core.scan import Scan, scene_size

ANCHORS = 3
LOOK_AHEAD = 40
APART_M = 2.0
APART_RAD = np.radians(15.0)
JUMP_M = 15.0


def window_findings(scans: Sequence[Scan], scores_of: PlaneScores = scores_of_planes) -> list[Finding]:
    """Findings of scans in time order, one for each code.

    All poses and times are looked at, and at most six of the clouds. `scores_of`: how planes are scored.
    """
    poses = np.stack([scan.T_odom_sensor for scan in scans])
    stamps_ns = np.array([scan.stamp_ns for scan in scans], dtype=np.int64)
    anchors = sorted({round(at) for at in np.linspace(0, len(scans) - 1, ANCHORS)})
    partners = {anchor: other for anchor in anchors if (other := _next_apart(scans, anchor)) is not None}
    looked_at = [scans[index] for index in sorted({*anchors, *partners.values()})]
    pairs = [ScenePair(scans[one], scans[other]) for one, other in partners.items()]
    findings = [
        *check_times(stamps_ns), *check_motion(poses, stamps_ns), *check_points(looked_at),
        *check_units([scene_size(scan) for scan in looked_at]), *check_gravity(looked_at, scores_of),
        *check_agreement(pairs),
    ]  # fmt: skip
    return list({finding.code: finding for finding in reversed(findings)}.values())[::-1]


def _next_apart(scans: Sequence[Scan], index: int) -> int | None:
    """The next scan from a place that a wrong pose would tell apart, None behind a jump."""
    for other in range(index + 1, min(index + LOOK_AHEAD, len(scans))):
        step = se3.inverse(scans[index].T_odom_sensor) @ scans[other].T_odom_sensor
        distance_m = float(np.linalg.norm(step[:3, 3]))
        if distance_m > APART_M or se3.rotation_angle(step) > APART_RAD:
            return other if distance_m < JUMP_M else None
    return None
