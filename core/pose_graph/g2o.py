"""Pose graphs as g2o text, SE3:QUAT.

g2o measures the error of an edge in the frame of its second vertex, as (x, y, z, qx, qy, qz). The vector part of a
quaternion is half the angle, so its information is four times that of the angle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revisit.core.geometry import se3
from revisit.core.pose_graph.graph import Node, PoseGraph

Array64 = NDArray[np.float64]

UPPER = np.triu_indices(6)
"""The numbers of an information matrix that g2o writes, row by row."""

HALF_ANGLES = np.diag([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
"""From an error in metres and radians to that of g2o."""


def write_g2o(graph: PoseGraph, T_map_submap: dict[str, Array64]) -> str:
    """The graph with its poses (n, 4, 4) of each session; vertices are numbered through, the first one is fixed."""
    lines: list[str] = []
    numbers: dict[Node, int] = {}
    for one in graph.trajectories:
        for ordinal, pose in enumerate(T_map_submap[one.session]):
            numbers[Node(one.session, ordinal)] = len(numbers)
            lines.append(f"VERTEX_SE3:QUAT {len(numbers) - 1} {_pose_text(pose)}")
    lines.append("FIX 0")
    for one in graph.trajectories:
        for ordinal, covariance in enumerate(one.step_covariances):
            T_step = se3.inverse(one.T_odom_submap[ordinal]) @ one.T_odom_submap[ordinal + 1]
            first = numbers[Node(one.session, ordinal)]
            lines.append(_edge_text(first, first + 1, T_step, covariance))
    for loop in graph.loops:
        covariance = loop.covariance_in_query / loop.independent_share
        lines.append(_edge_text(numbers[loop.match], numbers[loop.query], loop.T_match_query, covariance))
    return "\n".join(lines) + "\n"


def _pose_text(pose: se3.Matrix4) -> str:
    return " ".join(f"{value:.12g}" for value in (*pose[:3, 3], *se3.to_quaternion(pose)))


def _edge_text(first: int, second: int, pose: se3.Matrix4, covariance: Array64) -> str:
    information = np.linalg.inv(covariance)
    doubled = np.linalg.inv(HALF_ANGLES)
    upper = (doubled @ information @ doubled)[UPPER]
    return f"EDGE_SE3:QUAT {first} {second} {_pose_text(pose)} " + " ".join(f"{value:.12g}" for value in upper)
