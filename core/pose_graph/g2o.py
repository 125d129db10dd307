"""Pose graphs as g2o text: SE3:QUAT written and read, SE2 read.

g2o measures the error of an edge in the frame of its second vertex, as (x, y, z, qx, qy, qz). The vector part of a
quaternion is half the angle, so its information is four times that of the angle.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from revisit.core.errors import MalformedBody
from revisit.core.geometry import se3
from revisit.core.pose_graph.graph import LoopEdge, Node, PoseGraph, Trajectory

Array64 = NDArray[np.float64]

_UPPER = np.triu_indices(6)
_HALF_ANGLES = np.diag([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
_OUT_OF_PLANE = 1e-6
"""Variance of what an SE2 edge does not say: z, roll and pitch, m^2 and rad^2."""


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


def read_g2o(text: str, session: str = "g2o") -> PoseGraph:
    """The edges of a graph as one session: those between successive vertices are its steps, the others are loops.

    Raises MalformedBody where a line cannot be read or a step is missing.
    """
    steps: dict[int, tuple[se3.Matrix4, Array64]] = {}
    loops: list[LoopEdge] = []
    for first, second, T_first_second, covariance in _edges(text):
        if second == first + 1 and first not in steps:
            steps[first] = (T_first_second, covariance)
            continue
        turn = se3.adjoint(T_first_second)
        name = f"{first}-{second}-{len(loops)}"
        ends = Node(session, first), Node(session, second)
        loops.append(LoopEdge(name, *ends, T_first_second, turn @ covariance @ turn.T))
    if not steps or sorted(steps) != list(range(len(steps))):
        raise MalformedBody("the g2o graph lacks edges between successive vertices")
    poses = [np.eye(4)]
    for number in range(len(steps)):
        poses.append(poses[-1] @ steps[number][0])
    trajectory = Trajectory(session, np.stack(poses), np.stack([steps[n][1] for n in range(len(steps))]))
    return PoseGraph.of([trajectory], loops)


def _edges(text: str) -> Iterator[tuple[int, int, se3.Matrix4, Array64]]:
    """Ends, motion and covariance (6, 6), in the frame of the second end, of each edge."""
    for line in text.splitlines():
        words = line.split()
        try:
            if words[:1] == ["EDGE_SE3:QUAT"]:
                yield int(words[1]), int(words[2]), *_spatial([float(word) for word in words[3:]])
            elif words[:1] == ["EDGE_SE2"]:
                yield int(words[1]), int(words[2]), *_planar([float(word) for word in words[3:]])
        except (ValueError, IndexError, np.linalg.LinAlgError) as error:
            raise MalformedBody(f"a g2o edge cannot be read: {line[:80]!r}") from error


def _spatial(numbers: list[float]) -> tuple[se3.Matrix4, Array64]:
    information = np.zeros((6, 6))
    information[_UPPER] = numbers[7:28]
    information += np.triu(information, 1).T
    quaternion = np.array(numbers[3:7])
    pose = se3.from_quaternion(quaternion / np.linalg.norm(quaternion), numbers[:3])
    return pose, np.asarray(np.linalg.inv(_HALF_ANGLES @ information @ _HALF_ANGLES))


def _planar(numbers: list[float]) -> tuple[se3.Matrix4, Array64]:
    information = np.zeros((3, 3))
    information[np.triu_indices(3)] = numbers[3:9]
    information += np.triu(information, 1).T
    covariance = np.eye(6) * _OUT_OF_PLANE
    covariance[np.ix_([0, 1, 5], [0, 1, 5])] = np.linalg.inv(information)
    return se3.from_yaw(numbers[2], (numbers[0], numbers[1], 0.0)), covariance


def _pose_text(pose: se3.Matrix4) -> str:
    return " ".join(f"{value:.12g}" for value in (*pose[:3, 3], *se3.to_quaternion(pose)))


def _edge_text(first: int, second: int, pose: se3.Matrix4, covariance: Array64) -> str:
    information = np.linalg.inv(covariance)
    doubled = np.linalg.inv(_HALF_ANGLES)
    upper = (doubled @ information @ doubled)[_UPPER]
    return f"EDGE_SE3:QUAT {first} {second} {_pose_text(pose)} " + " ".join(f"{value:.12g}" for value in upper)
