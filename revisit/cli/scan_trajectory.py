"""Where each scan of a recording lies in the map: its odometry, corrected as the submaps about it are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.geometry.se3 import Matrix4

if TYPE_CHECKING:
    from revisit.evaluation.datasets import Recording
    from revisit.sdk.resources import Submap

Stamps = NDArray[np.int64]


@dataclass(frozen=True)
class Correction:
    """T_map_odom (4, 4) at the time of a submap."""

    stamp_ns: int
    T_map_odom: Matrix4


def corrections_of(submaps: Sequence[Submap], T_map_submap: dict[str, Matrix4]) -> list[Correction]:
    """The corrections of a session's submaps that have a pose in the map, in the order of time."""
    placed = [submap for submap in submaps if submap.name in T_map_submap]
    found = [Correction(one.stamp_ns, T_map_submap[one.name] @ se3.inverse(one.T_odom_submap)) for one in placed]
    return sorted(found, key=lambda one: one.stamp_ns)


def corrected(
    stamps_ns: Stamps, T_odom_scan: Sequence[Matrix4], corrections: Sequence[Correction]
) -> Iterator[Matrix4]:
    """T_map_scan (4, 4) of each scan; times rise.

    Between two submaps the correction goes over from one to the other on a screw motion, by the share of the way that
    the scan has made: while a robot stands it does not move. Before the first and behind the last it is theirs.
    """
    way_m = _way(T_odom_scan)
    at_m = np.interp([float(one.stamp_ns - stamps_ns[0]) for one in corrections], _since_first(stamps_ns), way_m)
    for T_odom, made_m in zip(T_odom_scan, way_m, strict=True):
        yield _blended(corrections, at_m, float(made_m)) @ T_odom


def trajectory_lines(recording: Recording, corrections: Sequence[Correction]) -> str:
    """`stamp x y z qx qy qz qw`, stamp in seconds, of every scan of a recording in the map."""
    from revisit.cli.pose_graph_files import tum_line

    poses = [recording.pose(index) for index in range(len(recording))]
    found = zip(recording.stamps_ns, corrected(recording.stamps_ns, poses, corrections), strict=True)
    return "".join(f"{tum_line(int(stamp_ns), pose)}\n" for stamp_ns, pose in found)


def _since_first(stamps_ns: Stamps) -> NDArray[np.float64]:
    """Differences of integers: nanoseconds since 1970 exceed the exact integers of float64."""
    return np.asarray(stamps_ns - stamps_ns[0], dtype=np.float64)


def _way(poses: Sequence[Matrix4]) -> NDArray[np.float64]:
    """The way (n,) made up to each pose, metres."""
    steps = np.diff(np.array([pose[:3, 3] for pose in poses]), axis=0)
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])


def _blended(corrections: Sequence[Correction], at_m: NDArray[np.float64], made_m: float) -> Matrix4:
    """The correction after `made_m` of the way; `at_m` (k,) is where those of the submaps are."""
    after = int(np.searchsorted(at_m, made_m))
    if after == 0:
        return corrections[0].T_map_odom
    if after == len(corrections):
        return corrections[-1].T_map_odom
    first, second = corrections[after - 1].T_map_odom, corrections[after].T_map_odom
    share = (made_m - at_m[after - 1]) / (at_m[after] - at_m[after - 1])
    return se3.interpolated(first, second, float(share))
