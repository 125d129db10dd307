"""A look at scans before they are sent: mistakes about units, frames and times are told at once, on the robot."""

from __future__ import annotations

import contextlib
import warnings
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import RevisitError
from revisit.core.sanity.finding import Finding
from revisit.core.sanity.ground import check_gravity
from revisit.core.sanity.numbers import check_motion, check_points, check_times, check_units
from revisit.core.scan import Scan, scene_size
from revisit.sdk.clouds import Cloud, PointCloud, PointsLike
from revisit.sdk.resources import Finding as SessionFinding

FIRST_LOOKS = (4, 16)
POSES_EVERY, CLOUDS_EVERY = 200, 1000
"""Scans after which poses and times are looked at, some milliseconds of a core, and points, up to 0.3 s."""

KEPT_POSES = 220
KEPT_CLOUDS = 4


class SuspiciousInput(UserWarning):
    """Likely mistakes in the data. They are sent all the same."""


class InputWatch:
    """Keeps some of the scans of a stream, and warns once for each kind of mistake (`SuspiciousInput`).

    Looks after 4 and 16 scans, then at poses and times after each 200 and at points after each 1,000; never at encoded
    clouds. The service compares scans with each other as well: see `Session.findings`.
    """

    def __init__(self) -> None:
        self._count = 0
        self._poses: deque[tuple[Any, int]] = deque(maxlen=KEPT_POSES)
        self._scans: deque[Scan] = deque(maxlen=KEPT_CLOUDS)
        self._warned: set[str] = set()

    def look(self, points: PointsLike, T_odom_sensor: Any, stamp_ns: int) -> None:
        """Take notice of a scan. Raises nothing: the service refuses unusable scans, with a warning here."""
        self._count += 1
        of_points = self._count in FIRST_LOOKS or self._count % CLOUDS_EVERY == 0
        with contextlib.suppress(RevisitError, ValueError, TypeError, IndexError):
            self._poses.append((np.asarray(T_odom_sensor, dtype=np.float64)[:3, :4], int(stamp_ns)))
            if not isinstance(points, Cloud) and (of_points or self._count <= KEPT_CLOUDS):
                rows = points.points if isinstance(points, PointCloud) else points
                self._keep(np.asarray(rows)[:, :3], T_odom_sensor, stamp_ns)
            if of_points or self._count % POSES_EVERY == 0:
                self._tell([*self._of_poses(), *(self._of_points() if of_points else [])])

    def _keep(self, points: NDArray[Any], T_odom_sensor: Any, stamp_ns: int) -> None:
        """Keep a scan to look at; one that the service will refuse is told of at once."""
        try:
            self._scans.append(Scan.validated(points, T_odom_sensor, stamp_ns))
        except RevisitError as error:
            if error.code not in self._warned:
                self._warned.add(error.code)
                words = f"{error.code}: the service refuses scan {self._count}: {error.message}"
                warnings.warn(words, SuspiciousInput, stacklevel=4)

    def _of_poses(self) -> list[Finding]:
        poses = np.stack([pose for pose, _ in self._poses])
        stamps_ns = np.array([stamp for _, stamp in self._poses], dtype=np.int64)
        return [*check_times(stamps_ns), *check_motion(poses, stamps_ns)]

    def _of_points(self) -> list[Finding]:
        scans = list(self._scans)
        if not scans:
            return []
        return [*check_units([scene_size(scan) for scan in scans]), *check_points(scans), *check_gravity(scans)]

    def _tell(self, findings: list[Finding]) -> None:
        for finding in findings:
            if finding.code not in self._warned:
                self._warned.add(finding.code)
                warn(finding.code, finding.measured, finding.cause, finding.advice)


def warn_of_session(findings: tuple[SessionFinding, ...]) -> None:
    """Warn of the service's findings in a session."""
    for finding in findings:
        warn(finding.code, f"in {finding.submaps} submaps", finding.cause, finding.advice)


def warn(code: str, measured: str, cause: str, advice: str) -> None:
    """One warning: measurement, likely cause, advice."""
    text = f"{code}: {measured}. Likely cause: {cause}. {advice[:1].upper()}{advice[1:]}."
    warnings.warn(text, SuspiciousInput, stacklevel=4)
