"""The sanity of a recording: some of its scans read, all of its poses and times looked at."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import OutOfRange, RevisitError
from revisit.core.geometry import se3
from revisit.core.point_columns import joined
from revisit.core.sanity.agreement import ScenePair, check_agreement
from revisit.core.sanity.finding import Finding
from revisit.core.sanity.ground import check_gravity, ground_plane
from revisit.core.sanity.numbers import check_motion, check_points, check_times, check_units
from revisit.core.scan import Scan, scene_size
from revisit.evaluation.datasets import Recording, findings_of

ANCHORS = 8
LOOK_AHEAD = 40
MAX_STARTS = 400
PAIR_DISTANCE_M = 3.0
PAIR_ROTATION_RAD = np.radians(15.0)


@dataclass(frozen=True)
class Inspection:
    """Measurements by name, and findings. `sample` holds the scans that were read."""

    figures: dict[str, float | int | str | None]
    findings: tuple[Finding, ...]
    sample: tuple[Scan, ...]


def inspect_recording(recording: Recording) -> Inspection:
    """Look at a recording; reads at most 16 scans, and raises nothing for those that cannot be read."""
    poses = np.stack([recording.pose(index) for index in range(len(recording))])
    sampled = _sampled(poses)
    read, refused = _read(recording, sampled)
    apart = [(one, other) for one, other in sampled if one != other and one in read and other in read]
    pairs = [ScenePair(read[one], read[other]) for one, other in apart]
    scans = [read[index] for index in sorted(read)]
    findings = [
        *_unreadable(refused),
        *findings_of(recording),
        *check_times(recording.stamps_ns),
        *check_motion(poses, recording.stamps_ns),
        *check_units([scene_size(scan) for scan in scans]),
        *(check_points(scans) if scans else []),
        *check_gravity(scans),
        *check_agreement(pairs),
    ]
    return Inspection(_figures(recording, poses, scans), _once(findings), tuple(scans))


def _sampled(poses: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Pairs of scans that lie a little apart: half of them spread evenly, half where the sensor turns most."""
    starts = sorted({round(at) for at in np.linspace(0, len(poses) - 1, MAX_STARTS)})
    ahead = {index: other for index in starts if (other := _next_apart(poses, index)) is not None}
    if not ahead:
        return [(index, index) for index in sorted({0, len(poses) // 2, len(poses) - 1})]
    known = sorted(ahead)
    even = [known[round(at)] for at in np.linspace(0, len(known) - 1, ANCHORS // 2)]
    most = sorted(known, key=lambda index: -_turn(poses[index], poses[ahead[index]]))[: ANCHORS // 2]
    return [(index, ahead[index]) for index in sorted({*even, *most})]


def _next_apart(poses: NDArray[np.float64], index: int) -> int | None:
    """The next scan taken 3 m on, or turned by 15 degrees."""
    for other in range(index + 1, min(index + LOOK_AHEAD, len(poses))):
        far = float(np.linalg.norm(poses[other, :3, 3] - poses[index, :3, 3])) > PAIR_DISTANCE_M
        if far or _turn(poses[index], poses[other]) > PAIR_ROTATION_RAD:
            return other
    return None


def _turn(one: se3.Matrix4, other: se3.Matrix4) -> float:
    return se3.rotation_angle(se3.inverse(one) @ other)


def _read(recording: Recording, pairs: list[tuple[int, int]]) -> tuple[dict[int, Scan], list[RevisitError]]:
    read: dict[int, Scan] = {}
    refused: list[RevisitError] = []
    for index in sorted({index for pair in pairs for index in pair}):
        try:
            read[index] = recording.scan(index)
        except RevisitError as error:
            refused.append(error)
    return read, refused


def _unreadable(refused: list[RevisitError]) -> Iterator[Finding]:
    """A finding for each reason why scans were refused."""
    reasons = Counter(type(error) for error in refused)
    for kind, count in reasons.items():
        first = next(error for error in refused if type(error) is kind)
        code, cause, advice = first.code.value.lower(), first.message, "send it otherwise: it would be refused"
        if kind is OutOfRange:
            code, cause, advice = "scene_too_large", "the points are in millimetres", "multiply them by 0.001"
        yield Finding(code, f"{count} of the scans that were read are refused", cause, advice)


def _once(findings: list[Finding]) -> tuple[Finding, ...]:
    """The findings, one for each code."""
    return tuple({finding.code: finding for finding in reversed(findings)}.values())[::-1]


def _figures(
    recording: Recording, poses: NDArray[np.float64], scans: list[Scan]
) -> dict[str, float | int | str | None]:
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    planes = [ground_plane(scan.points @ scan.T_odom_sensor[:3, :3].T) for scan in scans]
    heights = [plane.height_m for plane in planes if plane is not None]
    periods = np.diff(recording.stamps_ns)
    return {
        "scans": len(recording),
        "scans_read": len(scans),
        "travelled_m": round(float(steps.sum()), 2),
        "largest_step_m": round(float(steps.max()), 3) if len(steps) else None,
        "scan_period_s": float(np.median(periods)) / 1e9 if len(periods) else None,
        "point_columns": ", ".join(joined([scan.columns for scan in scans])) or None,
        "points_a_scan": _median([float(len(scan.points)) for scan in scans]),
        "scene_size_m": _median([scene_size(scan) for scan in scans]),
        "height_over_ground_m": _median(heights),
    }


def _median(values: list[float]) -> float | None:
    return round(float(np.median(values)), 2) if values else None
