"""Odometry from the clouds alone, by KISS-ICP (Vizzo et al., RA-L 2023), for recordings that have none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.geometry.upright import turned_up
from revisit.core.sanity.agreement import ScenePair, share_met
from revisit.core.sanity.ground import ground_plane
from revisit.core.scan import Points, Scan

if TYPE_CHECKING:
    from kiss_icp.kiss_icp import KissICP

KISS_ICP = "kiss-icp"
"""The odometry to ask for, in place of a topic."""

Report = Callable[[str, int, int], None]
"""Told of progress: the stage, how much of it is done, of how much."""

STAGE = "odometry by KISS-ICP"
MAX_RANGE_M, MIN_RANGE_M = (20.0, 100.0), 0.5
"""The range up to which points are registered follows the scene, within these; nearer returns are the robot's own."""

MIN_VOXEL_M = 0.4

CHECKED_PAIRS = 16
GOOD_SHARE = 0.55


@dataclass(frozen=True)
class LidarOdometry:
    """T_odom_sensor (n, 4, 4), z up where the first cloud shows the ground; the odometry begins at its origin.

    `met` is the share of a cloud's points that meet the cloud before, a mean of `CHECKED_PAIRS` pairs of neighbours.
    """

    T_odom_sensor: NDArray[np.float64]
    met: float

    def notes(self) -> list[str]:
        """Sentences on its quality, for people."""
        steps = np.linalg.norm(np.diff(self.T_odom_sensor[:, :3, 3], axis=0), axis=1)
        said = (
            f"poses by KISS-ICP from {len(self.T_odom_sensor)} clouds: {steps.sum():.0f} m, the longest step "
            f"{steps.max(initial=0.0):.2f} m; {100 * self.met:.0f} % of the points meet the cloud before"
        )
        doubt = "warning: few points meet the cloud before: the odometry has lost its way, or clouds are far apart"
        return [said, *([doubt] if self.met < GOOD_SHARE else [])]


def odometry_of(read: Callable[[int], Points], count: int, report: Report | None = None) -> LidarOdometry:
    """The motion of a sensor by its `count` clouds, in the order of their times; `read` gives the points (n, 3) of one.

    One thread, so that the same clouds give the same poses. Raises ImportError without KISS-ICP, and as `read` does.
    """
    first = _finite(read(0))
    T_odom_first, registration = _levelled(first), _kiss_icp(first)
    poses = np.empty((count, 4, 4))
    for index in range(count):
        registration.register_frame(_finite(read(index)), np.empty(0))
        poses[index] = T_odom_first @ registration.last_pose
        if report is not None:
            report(STAGE, index + 1, count)
    return LidarOdometry(poses, _mean_met(read, poses))


def _kiss_icp(cloud: NDArray[np.float64]) -> KissICP:
    """With the defaults of its authors but for the range, which follows the scene of a cloud (n, 3)."""
    try:
        from kiss_icp.config import KISSConfig
        from kiss_icp.config.config import DataConfig, MappingConfig, RegistrationConfig
        from kiss_icp.kiss_icp import KissICP
    except ModuleNotFoundError as error:
        message = f"KISS-ICP is not installed: pip install 'revisit-loops[{KISS_ICP}]'"
        raise ImportError(message, name="kiss_icp") from error
    ranges = np.linalg.norm(cloud, axis=1)
    reach = float(np.clip(1.5 * np.percentile(ranges, 95.0) if len(ranges) else 0.0, *MAX_RANGE_M))
    return KissICP(
        KISSConfig(
            data=DataConfig(max_range=reach, min_range=max(MIN_RANGE_M, 0.02 * reach), deskew=False),
            mapping=MappingConfig(voxel_size=max(MIN_VOXEL_M, 0.01 * reach)),
            registration=RegistrationConfig(max_num_threads=1),
        )
    )


def _finite(points: Points) -> NDArray[np.float64]:
    """Points (n, 3) as KISS-ICP takes them."""
    return points[np.isfinite(points).all(axis=1)].astype(np.float64)


def _levelled(cloud: NDArray[np.float64]) -> se3.Matrix4:
    """The first pose of the sensor: at the origin, turned by the least that levels the ground of a cloud (n, 3)."""
    plane = ground_plane(cloud)
    return np.eye(4) if plane is None else turned_up(plane.normal)


def _mean_met(read: Callable[[int], Points], T_odom_sensor: NDArray[np.float64]) -> float:
    """The mean share of points that meet the cloud before."""
    count = len(T_odom_sensor)
    seconds = np.unique(np.linspace(1, count - 1, min(CHECKED_PAIRS, max(count - 1, 0))).astype(int))

    def scan(index: int) -> Scan:
        return Scan.validated(_finite(read(index)).astype(np.float32), T_odom_sensor[index], index)

    shares = [share_met(ScenePair(scan(index - 1), scan(index))) for index in seconds]
    return float(np.mean(shares)) if shares else 1.0
